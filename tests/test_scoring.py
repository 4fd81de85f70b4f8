"""Scores of predictions against values worked out by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import cophy
from cophy.bootstrap import Ratio
from cophy.errors import CophyError
from cophy.scenario import Camera
from cophy.scoring import Predictions, Scores, Truth, average, compare, have_same_experiments, score, twins_of
from tests.commands import python
from tests.conftest import refused

# 10 m away, 90 degrees: one metre at the target's depth is 22.4 of 448 pixels
CAMERA = Camera(eye=[0.0, -10.0, 0.0], target=[0.0, 0.0, 0.0], field_of_view_deg=90.0)


def truth(**changes: Any) -> Truth:
    """Two experiments, T = 3 frames, K = 2 slots: two objects, and one object beside an empty slot."""
    arrays = Truth(
        experiment=np.array([12, 5]),
        position=np.zeros((2, 2, 2, 3)),
        stable=np.array([[[1, 0], [1, 1]], [[0, 1], [0, 0]]], dtype=bool),
        presence=np.array([[True, True], [False, True]]),
        initial=np.array([[[0.0, 0.0, 1.5], [0.0, 0.0, 0.5]], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]]),
        pair=np.array([-1, -1]),
        cluster=np.array([-1, -1]),
        cell=np.array([2, 0]),
        metric_dims=3,
        by_height=True,
        camera=CAMERA,
    )
    return replace(arrays, **changes)


def predictions(**changes: Any) -> Predictions:
    position = np.zeros((2, 2, 2, 3))
    position[0, 0, 0] = 3.0, 0.0, 0.0  # first experiment, first step, first object
    position[0, 1, 1] = 0.0, 3.0, 4.0  # last step, second object
    position[1, 1, 1] = 0.0, 0.0, 6.0  # second experiment
    position[1, :, 0] = np.nan  # empty slot
    logit = np.array([[[9.0, 9.0], [-9.0, 9.0]], [[np.nan, 9.0], [np.nan, 9.0]]])
    return replace(Predictions(np.array([12, 5]), position, logit), **changes)


def values_of(scores: Scores, name: str) -> list[float]:
    values = scores.values[name]
    assert isinstance(values, np.ndarray)
    return values.tolist()


def four(**changes: Any) -> Truth:
    """Two twin pairs, one step, one object beside an empty slot: D of pair 8 differs by 2 m in x, of pair 3 by 4 m in y."""
    position = np.zeros((4, 1, 2, 3))
    position[2, 0, 0, 0], position[3, 0, 0, 1] = 2.0, 4.0
    arrays = Truth(
        experiment=np.arange(4),
        position=position,
        stable=np.zeros((4, 1, 2), dtype=bool),
        presence=np.array([[True, False]] * 4),
        initial=np.zeros((4, 2, 3)),
        pair=np.array([8, 3, 8, 3]),
        cluster=np.array([8, 3, 8, 3]),
        cell=np.array([0, 0, 1, 1]),
        metric_dims=3,
    )
    return replace(arrays, **changes)


def along_x(*x: float, **changes: Any) -> Predictions:
    """The object of every experiment at this place on the x axis; the empty slot anywhere."""
    position = np.random.default_rng(0).normal(size=(len(x), 1, 2, 3))
    position[:, 0, 0] = 0.0
    position[:, 0, 0, 0] = x
    return replace(Predictions(np.arange(len(x)), position), **changes)


def test_position_errors_are_those_worked_out_by_hand() -> None:
    scores = score(predictions(), truth())
    assert values_of(scores, "mse") == pytest.approx([(9 / 3 + 25 / 3) / 4, (36 / 3) / 2])
    assert values_of(scores, "final_position_error") == pytest.approx([5.0 / 2, 6.0])
    assert scores.means()["mse"] == pytest.approx(((9 / 3 + 25 / 3) / 4 + 6) / 2)
    flat = score(predictions(), truth(metric_dims=2))
    assert values_of(flat, "mse") == pytest.approx([(9 / 2 + 9 / 2) / 4, 0.0])
    assert values_of(flat, "final_position_error") == pytest.approx([3.0 / 2, 0.0])


def test_stability_counts_objects_and_steps() -> None:
    scores = score(predictions(), truth())
    assert values_of(scores, "stability_accuracy") == [0.5, 0.5]
    assert values_of(scores, "stability_base_rate") == [0.75, 0.5]
    assert values_of(scores, "sequence_stability_accuracy") == [0.0, 0.0]
    once = score(predictions(stable_logit=np.array([[[9.0, -9.0]], [[9.0, -9.0]]])), truth())
    assert values_of(once, "stability_accuracy") == [(2 + 1) / 4, 0.5]
    assert values_of(once, "sequence_stability_accuracy") == [1.0, 1.0]
    assert not [name for name in score(predictions(stable_logit=None), truth()).values if "stability" in name]


def test_pixel_errors_are_given_by_height_in_c() -> None:
    position = np.zeros((2, 2, 2, 3))
    position[0, -1, 0], position[0, -1, 1] = (1.0, 0, 0), (0, 0, -2.0)
    position[1, -1, 1] = 0.0, 10.0, 3.0  # twice as far away
    scores = score(predictions(position=position), truth())
    assert values_of(scores, "pixel_error") == pytest.approx([(22.4 + 44.8) / 2, 33.6])
    assert values_of(scores, "pixel_error_1") == pytest.approx([44.8, 33.6])
    assert values_of(scores, "pixel_error_2") == pytest.approx([22.4, np.nan], nan_ok=True)
    assert scores.means()["pixel_error_by_height"] == pytest.approx(((44.8 + 33.6) / 2 + 22.4) / 2)
    assert "pixel_error_1" not in score(predictions(), truth(by_height=False)).values
    assert "pixel_error" not in score(predictions(), truth(camera=None)).values


def test_twins_are_found_by_their_pair_in_any_order() -> None:
    assert twins_of(np.array([3, 7, 3, -1, 8, -1, 9, 8])).tolist() == [2, 1, 0, 3, 7, 5, 6, 4]


def test_the_difference_explained_is_that_of_the_formula() -> None:
    """ΔP = 1 m of the true 2 m in pair 8, nothing of 4 m in pair 3: 1 - (1 + 16) / (4 + 16)."""
    assert score(along_x(0.0, 5.0, 1.0, 5.0), four()).means()["twin_difference_explained"] == pytest.approx(1 - 17 / 20)
    only_x = score(along_x(0.0, 5.0, 1.0, 5.0), four(metric_dims=1)).values["twin_difference_explained"]
    assert isinstance(only_x, Ratio)
    assert only_x.denominator.tolist() == [4.0, 0.0, 4.0, 0.0]


def test_the_right_twin_is_the_nearer_one() -> None:
    assert values_of(score(along_x(0.5, 3.0, 0.9, 3.0), four()), "right_twin_chosen") == [1.0, 1.0, 0.0, 0.0]
    assert values_of(score(along_x(1.0, 0.0, 1.0, 0.0), four()), "right_twin_chosen") == [0.5, 1.0, 0.5, 0.0]


def test_an_experiment_without_its_twin_does_not_count_for_twins() -> None:
    scores = score(along_x(0.0, 5.0, 1.0, 5.0), four(pair=np.array([8, 3, 8, -1]), cluster=np.array([8, 3, 8, -1])))
    assert values_of(scores, "right_twin_chosen") == pytest.approx([1.0, np.nan, 0.5, np.nan], nan_ok=True)
    assert scores.means()["twin_difference_explained"] == pytest.approx(1 - 1 / 4)
    assert scores.cluster.tolist() == [8, 3, 8, -4]
    for pair in ([-1, -1, -1, -1], [0, 1, 2, 3]):
        alone = score(along_x(0.0, 5.0, 1.0, 5.0), four(pair=np.array(pair), cluster=np.array(pair)))
        assert list(alone.values) == ["mse", "final_position_error"]
        assert len(set(alone.cluster.tolist())) == 4  # each is resampled by itself


def test_the_sampling_variance_is_subtracted() -> None:
    """Each position is 1 m off, with a variance of 1 m²; the difference of twins that do not share samples has 2 m²."""
    variance = np.zeros((4, 1, 2, 3))
    variance[..., 0] = 1.0
    sampled = score(along_x(1.0, 1.0, 2.0, 1.0, draw_variance=variance), four())
    assert values_of(sampled, "mse") == pytest.approx([0.0, 0.0, -1 / 3, 16 / 3])
    explained = sampled.values["twin_difference_explained"]
    assert isinstance(explained, Ratio)
    assert explained.numerator.tolist() == [4.0 - (1.0 - 2.0), 0.0, 4.0 - (1.0 - 2.0), 0.0]  # pair 3 shares its samples


def test_the_order_of_rows_is_irrelevant() -> None:
    expected, order = score(predictions(), truth(pair=np.array([4, 4]), cluster=np.array([4, 4]))), np.array([1, 0])
    turned = Predictions(*(getattr(predictions(), name)[order] for name in ("experiment", "position", "stable_logit")))
    for name, value in score(turned, truth(pair=np.array([4, 4]), cluster=np.array([4, 4]))).values.items():
        np.testing.assert_array_equal(value, expected.values[name])
    scores = score(along_x(0.0, 5.0, 1.0, 5.0), four())
    mixed = np.array([3, 0, 1, 2])
    names = ("experiment", "position", "stable", "presence", "initial", "pair", "cluster", "cell")
    permuted = score(along_x(0.0, 5.0, 1.0, 5.0), four(**{name: getattr(four(), name)[mixed] for name in names}))
    assert permuted.experiment.tolist() == mixed.tolist()
    assert values_of(permuted, "mse") == [values_of(scores, "mse")[row] for row in mixed]
    assert permuted.means() == pytest.approx(scores.means())


def test_intervals_resample_clusters() -> None:
    predicted = along_x(0.0, 5.0, 1.0, 5.0)
    scores = score(predicted, four())
    pairs = np.array([scores.mse[[0, 2]].mean(), scores.mse[[1, 3]].mean()])
    assert scores.intervals()["mse"] == pytest.approx((pairs.min(), pairs.max()))
    together = score(predicted, four(cluster=np.array([5, 5, 5, 5])))
    assert together.means() == scores.means()
    assert together.intervals()["mse"] == pytest.approx((pairs.mean(), pairs.mean()))


def test_twins_are_in_one_cluster() -> None:
    with pytest.raises(CophyError, match="twins are in different clusters"):
        score(along_x(0.0, 5.0, 1.0, 5.0), four(cluster=np.array([1, 2, 3, 4])))


def test_scores_of_some_experiments() -> None:
    scores = score(along_x(0.0, 5.0, 1.0, 5.0), four())
    second = scores.select(four().cell == 1)
    assert second.experiment.tolist() == [2, 3]
    assert second.means()["mse"] == pytest.approx((1 / 3 + (25 + 16) / 3) / 2)
    assert second.means()["twin_difference_explained"] == pytest.approx(1 - 17 / 20)


def test_some_experiments_lack_measures_of_which_they_have_no_value() -> None:
    alone = np.array([8, 3, 8, -1])
    scores = score(along_x(0.0, 5.0, 1.0, 5.0), four(pair=alone, cluster=alone))
    of_twins = ["twin_difference_explained", "right_twin_chosen"]
    assert list(scores.select(np.array([0, 2, 3])).values) == [*list(scores.values)[:2], *of_twins]
    assert list(scores.select(np.array([1, 3])).values) == ["mse", "final_position_error"]
    of_two_objects, of_one = (score(predictions(), truth()).select(np.array([row])).values.keys() for row in (0, 1))
    assert of_two_objects - of_one == {"pixel_error_2"}


def test_two_methods_are_compared_experiment_by_experiment() -> None:
    ours, others = score(along_x(0.0, 5.0, 1.0, 5.0), four()), score(along_x(0.0, 6.0, 2.0, 6.0), four())
    difference = compare(ours, others)
    assert difference.mse.tolist() == (ours.mse - others.mse).tolist()
    assert difference.means()["twin_difference_explained"] == pytest.approx((1 - 17 / 20) - (1 - 16 / 20))
    assert compare(ours, ours).intervals() == dict.fromkeys(ours.values, (0.0, 0.0))
    low, high = difference.intervals()["mse"]
    assert (low, high) == pytest.approx((-22 / 6, 1 / 6))
    seeds = average([ours, others])
    assert seeds.mse.tolist() == pytest.approx(((ours.mse + others.mse) / 2).tolist())
    assert seeds.means()["twin_difference_explained"] == pytest.approx(1 - 16.5 / 20)


def test_methods_are_compared_in_the_measures_that_both_have() -> None:
    both, positions = score(predictions(), truth()), score(predictions(stable_logit=None), truth())
    assert both.values.keys() > positions.values.keys()
    for difference in (compare(both, positions), compare(positions, both)):
        assert difference.values.keys() == positions.values.keys()
        assert difference.mse.tolist() == [0.0, 0.0]
    without_camera = score(predictions(), truth(camera=None))
    assert list(average([positions, without_camera]).values) == ["mse", "final_position_error"]


def test_scores_of_other_experiments_are_not_compared() -> None:
    ours = score(along_x(0.0, 5.0, 1.0, 5.0), four())
    others = [
        ours.select(np.array([0, 1, 2])),
        score(along_x(0.0, 5.0, 1.0, 5.0), four(position=four().position + 1.0)),  # of other data with the same ids
        score(along_x(0.0, 5.0, 1.0, 5.0), four(cluster=np.array([1, 0, 1, 0]))),
    ]
    for other in others:
        assert not have_same_experiments([ours, other])
        with pytest.raises(CophyError, match="same experiments"):
            compare(ours, other)


def non_finite(name: str) -> Predictions:
    array = getattr(predictions(), name).copy()
    array[0, 1, 1] = np.inf
    return predictions(**{name: array})


WRONG = {
    "1 experiments are missing, the first is 5": predictions(
        **{name: getattr(predictions(), name)[:1] for name in ("experiment", "position", "stable_logit")}
    ),
    "1 experiments are predicted twice, the first is 12": predictions(experiment=np.array([12, 12])),
    "2 experiments are not among those to be scored, the first is 0": predictions(experiment=np.array([0, 1])),
    "experiment is float64": predictions(experiment=np.array([12.0, 5.0])),
    "position is float64 of shape (2, 2, 2, 2)": predictions(position=predictions().position[..., :2]),
    "position is int64": predictions(position=np.zeros((2, 2, 2, 3), dtype=np.int64)),
    "stable_logit is float64 of shape (2, 3, 2)": predictions(stable_logit=np.zeros((2, 3, 2))),
    "stable_logit is bool": predictions(stable_logit=np.ones((2, 2, 2), dtype=bool)),
    "draw_variance is float64 of shape (2, 1, 2, 3)": predictions(draw_variance=np.zeros((2, 1, 2, 3))),
    "position of experiment 12 has non-finite values": non_finite("position"),
    "stable_logit of experiment 12 has non-finite values": non_finite("stable_logit"),
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_predictions_are_refused_in_one_line(message: str) -> None:
    with refused(message):
        score(WRONG[message], truth())


WRONG_TRUTHS: dict[str, dict[str, Any]] = {
    "position has shape (2, 2, 3)": {"position": np.zeros((2, 2, 3))},
    "stable is bool of shape (2, 3, 2)": {"stable": np.zeros((2, 3, 2), dtype=bool)},
    "presence is int64": {"presence": np.ones((2, 2), dtype=np.int64)},
    "position of experiment 12 has non-finite values": {
        "position": np.full((2, 2, 2, 3), np.nan),
        "initial": np.full((2, 2, 3), np.nan),
    },
    "the ids of experiments have to differ": {"experiment": np.array([5, 5])},
    "an experiment has no object": {"presence": np.array([[True, True], [False, False]])},
}


@pytest.mark.parametrize("message", WRONG_TRUTHS)
def test_a_wrong_truth_is_refused(message: str) -> None:
    with refused(message):
        score(predictions(), truth(**WRONG_TRUTHS[message]))


def test_a_pair_has_two_experiments_at_most() -> None:
    with pytest.raises(CophyError, match="a twin pair has more than two experiments"):
        score(along_x(0.0, 0.0, 0.0, 0.0), four(pair=np.array([3, 3, 8, 3])))


def test_scoring_needs_numpy_alone() -> None:
    """`cophy.score` is public, and imports no torch."""
    code = "import sys, cophy; cophy.score; print(*{'torch', 'lightning', 'hydra', 'omegaconf', 'pybullet'} & set(sys.modules))"
    assert python("-c", code).stdout.split() == []
    assert cophy.score is score
