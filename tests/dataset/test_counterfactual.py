import numpy as np
import torch

from cophy.dataset.counterfactual import CounterfactualDataset, confounder_statistics, standardise, to_batch
from cophy.types import CONFOUNDERS, HORIZONTAL


def test_frames_are_every_fourth_state(tiny) -> None:
    spec, arrays = tiny
    batch = to_batch(arrays, spec.scenario)
    assert batch.observed.shape[1] == 30
    assert batch.target.shape[1] == 29
    np.testing.assert_array_equal(batch.observed[:, 7], arrays["states"][:, 0, 28, :, :3])
    np.testing.assert_array_equal(batch.initial, arrays["states"][:, 1, 0, :, :3])
    np.testing.assert_array_equal(batch.target[:, 0], arrays["states"][:, 1, 4, :, :3])
    np.testing.assert_array_equal(batch.target[:, 28], arrays["states"][:, 1, 116, :, :3])


def test_an_object_is_stable_while_it_stays_slow_between_two_frames(tiny) -> None:
    spec, arrays = tiny
    speed = np.linalg.norm(arrays["states"][3, 1, :, :, 7:10], axis=-1)
    stable = to_batch(arrays, spec.scenario).stable[3]
    for frame in (1, 12, 29):
        slow = (speed[4 * frame - 3 : 4 * frame + 1] < spec.scenario.task.stable_speed).all(axis=0)
        np.testing.assert_array_equal(stable[frame - 1], slow)


def test_confounders_are_standardised_over_present_objects(tiny) -> None:
    spec, arrays = tiny
    raw = to_batch(arrays, spec.scenario)
    batch = standardise(raw, confounder_statistics(raw))
    values = batch.confounders[batch.observed_presence]
    varies = raw.confounders[raw.observed_presence].abs().sum(dim=0) > 0
    horizontal = [column for pair in HORIZONTAL for column in pair]
    scalars = [column for column in range(len(CONFOUNDERS)) if column not in horizontal]
    varies[scalars] = raw.confounders[raw.observed_presence].std(dim=0)[scalars] > 0
    torch.testing.assert_close(values.mean(dim=0)[scalars], torch.zeros(len(scalars)), atol=1e-5, rtol=0)
    torch.testing.assert_close(values.std(dim=0)[scalars], varies[scalars].float(), atol=1e-5, rtol=0)
    for pair in HORIZONTAL:  # one scale for both components, so that directions stay what they are
        size = values[:, pair].square().mean().sqrt()
        torch.testing.assert_close(size, varies[pair].any().float(), atol=1e-5, rtol=0)
    assert not batch.confounders[~batch.observed_presence].any()


def test_a_loader_visits_every_experiment_once(tiny) -> None:
    spec, arrays = tiny
    data = CounterfactualDataset(to_batch(arrays, spec.scenario))
    batches = list(data.loader(16, shuffle=True))
    assert [len(batch.initial) for batch in batches] == [16, 16, 8]
    seen = torch.cat([batch.target for batch in batches]).flatten(1).sum(dim=1)
    torch.testing.assert_close(seen.sort().values, data.batch.target.flatten(1).sum(dim=1).sort().values)
