"""What a model sees of stored experiments, with true positions and with estimated ones."""

from dataclasses import replace

import numpy as np
import torch

from cophy.config import settings
from cophy.dataset.features import (
    DeclaredInputs,
    confounder_features,
    confounder_statistics,
    estimated_inputs,
    to_batch,
)
from cophy.types import Batch


def test_frames_are_every_fourth_state(tiny) -> None:
    spec, arrays = tiny
    batch = to_batch(arrays, spec.scenario)
    inputs, targets = batch.inputs, batch.targets
    num_frames = spec.scenario.clock.num_frames
    assert inputs.observed.shape[1] == num_frames
    assert targets.position.shape[1] == inputs.num_steps == num_frames - 1
    np.testing.assert_array_equal(inputs.observed[:, 7], arrays["states"][:, 0, 28, :, :3])
    np.testing.assert_array_equal(inputs.initial, arrays["states"][:, 1, 0, :, :3])
    np.testing.assert_array_equal(targets.position[:, 0], arrays["states"][:, 1, 4, :, :3])
    np.testing.assert_array_equal(targets.position[:, -1], arrays["states"][:, 1, -4, :, :3])


def test_true_confounders_are_no_part_of_it(tiny) -> None:
    spec, arrays = tiny
    assert to_batch(arrays, spec.scenario).inputs.confounders is None


def test_an_object_is_stable_while_it_stays_slow_between_two_frames(tiny) -> None:
    spec, arrays = tiny
    speed = np.linalg.norm(arrays["states"][3, 1, :, :, 7:10], axis=-1)
    stable = to_batch(arrays, spec.scenario).targets.stable[3]
    for frame in (1, 12, spec.scenario.clock.num_frames - 1):
        slow = (speed[4 * frame - 3 : 4 * frame + 1] < spec.scenario.task.stable_speed).all(axis=0)
        np.testing.assert_array_equal(stable[frame - 1], slow & arrays["presence"][3, 1])


def test_what_an_empty_slot_holds_is_false(tiny) -> None:
    spec, arrays = tiny
    batch = to_batch(arrays, spec.scenario)
    assert not arrays["presence"].all()
    assert not batch.inputs.observed_stable.transpose(1, 2)[~batch.inputs.observed_presence].any()
    assert not batch.targets.stable.transpose(1, 2)[~batch.targets.presence].any()


def estimates(batch: Batch, presence_logit: np.ndarray) -> dict[str, np.ndarray]:
    """12.5 cm beside the truth."""
    whole = torch.cat([batch.targets.initial[:, None], batch.targets.position], dim=1)
    truth = torch.stack([batch.inputs.observed, whole], dim=1)
    return {"position": truth.numpy() + 0.125, "presence_logit": presence_logit.astype(np.float32)}


def seen(batch: Batch, found: dict[str, np.ndarray]) -> Batch:
    return replace(batch, inputs=estimated_inputs(found, settings("train", "scenario=blocktower").scenario))


def test_estimates_replace_what_is_seen_and_nothing_of_what_is_asked(tower_batch: Batch) -> None:
    inputs = tower_batch.inputs
    presence = torch.stack([inputs.observed_presence, inputs.presence], dim=1)[:, :, None].expand(-1, 2, 30, 4)
    found = seen(tower_batch, estimates(tower_batch, np.where(presence, 5.0, -5.0)))
    torch.testing.assert_close(found.inputs.initial, (inputs.initial + 0.125) * inputs.presence[..., None])
    expected = (inputs.observed[:, 7] + 0.125) * inputs.observed_presence[..., None]
    torch.testing.assert_close(found.inputs.observed[:, 7], expected)
    for name in ("presence", "observed_presence"):
        torch.testing.assert_close(getattr(found.inputs, name), getattr(inputs, name))


def test_estimates_change_neither_targets_nor_confounders(tiny) -> None:
    spec, arrays = tiny
    shape = (len(arrays["split"]), 2, spec.scenario.clock.num_frames, spec.scenario.num_slots)
    zeros = {"position": np.zeros((*shape, 3), np.float32), "presence_logit": np.zeros(shape, np.float32)}
    statistics = confounder_statistics(confounder_features(arrays), torch.from_numpy(arrays["presence"][:, 0]))
    true, estimated = (
        to_batch(
            arrays | zeros, spec.scenario, DeclaredInputs(confounders=True), statistics=statistics, estimated=estimated
        )
        for estimated in (False, True)
    )
    assert not estimated.inputs.observed.any()
    assert torch.equal(estimated.targets.position, true.targets.position)
    assert torch.equal(estimated.targets.presence, true.targets.presence)
    assert torch.equal(estimated.inputs.confounders, true.inputs.confounders)


def test_presence_is_that_of_most_frames_in_ab_and_of_the_only_frame_in_c(tower_batch: Batch) -> None:
    logit = np.full((len(tower_batch), 2, 30, 4), -1.0)
    logit[:, 0, :16, 0] = 1.0  # 16 of 30 frames
    logit[:, 0, :15, 1] = 1.0  # half of them
    logit[:, 1, 0, 2] = 1.0
    logit[:, 1, 1:, 3] = 1.0  # only after C
    found = seen(tower_batch, estimates(tower_batch, logit)).inputs
    assert found.observed_presence[0].tolist() == [True, False, False, False]
    assert found.presence[0].tolist() == [False, False, True, False]
    assert not found.initial[:, [0, 1, 3]].any()


def test_stability_of_ab_is_what_estimates_look_like(tower_batch: Batch) -> None:
    moving = estimates(tower_batch, np.full((len(tower_batch), 2, 30, 4), 1.0))
    moving["position"] = np.zeros_like(moving["position"])
    moving["position"][:, 0, 10:, 1, 0] = 0.03  # 3 cm in a fifth of a second: 0.15 m/s
    stable = seen(tower_batch, moving).inputs.observed_stable
    assert not stable[:, 9, 1].any()
    stable[:, 9, 1] = True
    assert stable.all()
