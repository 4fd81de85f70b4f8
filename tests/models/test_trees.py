"""Extra trees in canonical frames."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from cophy.dataset.features import confounder_features, confounder_statistics, to_batch
from cophy.dataset.spec import DatasetSpec
from cophy.models import CopyB, Trees
from cophy.models.trees import canonical, statics_features
from cophy.scenario import Collision, Scenario
from cophy.scenario.scenario import disc_symmetries
from cophy.training.augmentation import transform
from cophy.training.metrics import mean_squared_error
from cophy.types import Batch, Inputs, take
from tests.models.networks import permute_slots, present_positions, with_noise_where_absent

TRUE = {"confounders": "ground_truth"}
SEED = 0


@pytest.fixture(scope="session")
def tiny_batch(tiny: tuple[DatasetSpec, dict[str, Any]]) -> tuple[Batch, Scenario, tuple[Tensor, Tensor]]:
    """All experiments of each scenario's tiny dataset, with standardised confounders and their statistics."""
    spec, arrays = tiny
    statistics = confounder_statistics(confounder_features(arrays), torch.from_numpy(arrays["presence"][:, 0]))
    batch = to_batch(arrays, spec.scenario, ("confounders",), statistics=statistics)
    return batch, spec.scenario, statistics


TinyBatch = tuple[Batch, Scenario, tuple[Tensor, Tensor]]


def fitted(tiny_batch: TinyBatch, *, num_trees: int = 3, **arguments: Any) -> Trees:
    trees = Trees(num_trees=num_trees, min_samples_leaf=1, **arguments)
    trees.fit(*tiny_batch, SEED)
    return trees


def symmetries(scenario: Scenario, size: int) -> Tensor:
    """One matrix per experiment under which the scenario's frames must not change, in turn."""
    matrices = disc_symmetries(5) if isinstance(scenario, Collision) else scenario.symmetries()
    return torch.from_numpy(matrices).float()[torch.arange(size) % len(matrices)]


@pytest.mark.parametrize("arguments", [{}, TRUE])
def test_trees_beat_copy_b_on_what_they_are_fitted_to(tiny_batch: TinyBatch, arguments: dict) -> None:
    batch, scenario, _ = tiny_batch
    mse = mean_squared_error(scenario.task.metric_dims)
    errors = [mse(model(batch.inputs), batch.targets).mean() for model in (fitted(tiny_batch, **arguments), CopyB())]
    assert errors[0] < 0.1 * errors[1]  # only the frames and rounding stand between leaves of one row and D


def test_frames_remove_symmetries(tiny_batch: TinyBatch) -> None:
    batch, scenario, statistics = tiny_batch
    moved = transform(batch, symmetries(scenario, len(batch)))
    rows, others = (canonical(each.inputs, scenario, sees_confounders=True) for each in (batch, moved))
    np.testing.assert_allclose(others.features, rows.features, atol=1e-4)
    if scenario.statics is not None:
        features = [statics_features(each.inputs, scenario.statics, statistics) for each in (batch, moved)]
        np.testing.assert_allclose(*features, atol=1e-4)


def test_predictions_move_with_the_experiment(tiny_batch: TinyBatch) -> None:
    """Inputs that differ by rounding can fall into other leaves, so a few predictions may differ."""
    batch, scenario, _ = tiny_batch
    matrices, trees = symmetries(scenario, len(batch)), fitted(tiny_batch)
    predicted = replace(batch, targets=replace(batch.targets, position=trees(batch.inputs).position))
    expected = transform(predicted, matrices).targets.position
    difference = (trees(transform(batch, matrices).inputs).position - expected).abs().amax(dim=(1, 2, 3))
    assert (difference < 1e-3).float().mean() > 0.9


@pytest.mark.parametrize("arguments", [{}, TRUE])
def test_permuting_objects_permutes_the_prediction(tiny_batch: TinyBatch, arguments: dict) -> None:
    inputs, trees = tiny_batch[0].inputs, fitted(tiny_batch, **arguments)
    order = torch.randperm(inputs.presence.shape[1], generator=torch.Generator().manual_seed(0)).tolist()
    expected = present_positions(trees(inputs), inputs)[:, :, order]
    permuted = permute_slots(inputs, order)
    torch.testing.assert_close(present_positions(trees(permuted), permuted), expected, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("arguments", [{}, TRUE])
def test_absent_objects_change_nothing(tiny_batch: TinyBatch, arguments: dict) -> None:
    inputs, trees = tiny_batch[0].inputs, fitted(tiny_batch, **arguments)
    noisy = with_noise_where_absent(inputs)
    expected = present_positions(trees(inputs), inputs)
    torch.testing.assert_close(present_positions(trees(noisy), inputs), expected)


def test_an_experiment_does_not_depend_on_its_batch(tiny_batch: TinyBatch) -> None:
    inputs, trees = tiny_batch[0].inputs, fitted(tiny_batch, **TRUE)
    alone = trees(take(inputs, slice(2, 3))).position
    torch.testing.assert_close(alone, trees(inputs).position[2:3])
    assert trees(take(inputs, slice(0, 0))).position.shape == (0, *alone.shape[1:])


def test_the_seed_determines_the_trees(tiny_batch: TinyBatch) -> None:
    inputs = tiny_batch[0].inputs
    first, second = (fitted(tiny_batch)(inputs).position for _ in range(2))
    torch.testing.assert_close(first, second, atol=0, rtol=0)


@pytest.mark.parametrize("tiny", ["blocktower"], indirect=True)
def test_statics_says_which_towers_stand(tiny_batch: TinyBatch) -> None:
    batch, scenario, statistics = tiny_batch
    features, slots = statics_features(batch.inputs, scenario.statics, statistics), batch.inputs.presence.shape[1]
    inputs, targets = batch.inputs, batch.targets
    a, c = ((inputs.observed[:, :1], inputs.observed[:, 1:]), (inputs.initial[:, None], targets.position))
    for column, (start, after), present in ((slots, a, inputs.observed_presence), (-1, c, inputs.presence)):
        distance = ((after - start).norm(dim=-1) * present[:, None]).amax(dim=(1, 2)).numpy()
        np.testing.assert_array_equal(features[:, column] > 0, distance < scenario.statics.fallen_distance)


def test_true_confounders_are_needed_only_where_they_are_enabled(tiny_batch: TinyBatch) -> None:
    inputs: Inputs = replace(tiny_batch[0].inputs, confounders=None)
    assert fitted(tiny_batch)(inputs).position.isfinite().all()
    with pytest.raises(ValueError, match="true confounders are not among the inputs"):
        fitted(tiny_batch, **TRUE)(inputs)
