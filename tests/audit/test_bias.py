"""Classifiers predict nothing where twins are complete, and find planted biases."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import pytest
from sklearn.ensemble import HistGradientBoostingRegressor

from cophy.audit import bias
from cophy.audit.bias import ClassifierCheck, check_bias, check_classifier, check_stored_order, initial_scene
from cophy.scenario import Shape
from tests.audit.failing import failing
from tests.conftest import SCENARIOS, tiny_spec

PAIRS = 60
SLOTS = {"blocktower": 4, "balls": 9, "collision": 4}


@pytest.fixture(autouse=True)
def quick_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    """Classifiers of 25 trees, not 100: the planted biases are obvious."""
    monkeypatch.setattr(bias, "HistGradientBoostingRegressor", partial(HistGradientBoostingRegressor, max_iter=25))


def synthetic_pairs(name: str) -> dict[str, np.ndarray]:
    """Twin pairs of random geometry with two states per sequence: nothing moves in the first twin, everything in the second.

    Every other pair has the opposite outcome in AB.
    """
    rng, count, slots = np.random.default_rng(0), SCENARIOS[name], SLOTS[name]
    index = np.array([rng.permutation(slots) for _ in range(PAIRS)])
    scene = np.zeros((PAIRS, 2, 2, slots, 13))
    scene[..., :2] = rng.uniform(-0.5, 0.5, (PAIRS, 1, 1, slots, 2))
    scene[..., 6] = 1.0
    arrays = {
        "twin": np.arange(PAIRS),
        "object_index": np.where(index < count, index, -1).astype(np.int8),
        "shape": np.where(index < count, int(Shape.BOX), 0).astype(np.uint8),
        "presence": np.repeat((index < count)[:, None], 2, axis=1),
        "do_operation": rng.integers(2, size=PAIRS),
        "do_slot": index.argmin(axis=1),
        "do_offset": rng.uniform(-0.5, 0.5, (PAIRS, 3)).astype(np.float32),
        "states": scene * (index < count)[:, None, None, :, None],
    }
    arrays = {key: np.repeat(array, 2, axis=0) for key, array in arrays.items()}
    moves = np.stack([np.arange(2 * PAIRS) % 4 // 2 ^ np.arange(2 * PAIRS) % 2, np.arange(2 * PAIRS) % 2], axis=1)
    arrays["states"][:, :, 1, :, 0] += moves[..., None] * arrays["presence"]
    return arrays


def select(arrays: dict[str, np.ndarray], rows: Sequence[int] | np.ndarray) -> dict[str, np.ndarray]:
    return {name: array[rows] for name, array in arrays.items()}


def checks_by_name(name: str, arrays: dict[str, np.ndarray]) -> dict[str, ClassifierCheck]:
    checks = list(check_bias(arrays, tiny_spec(name)))
    assert all(isinstance(check, ClassifierCheck) for check in checks)
    return {check.name: check for check in checks}  # type: ignore[misc]


@pytest.mark.parametrize("name", ["blocktower", "collision"])
def test_what_twins_share_predicts_exactly_nothing(name: str) -> None:
    checks = checks_by_name(name, synthetic_pairs(name))
    assert not failing(checks.values())
    shared = [check for line, check in checks.items() if "outcome of AB" not in line and "median" not in line]
    assert len(shared) == {"blocktower": 7}.get(name, 4)
    assert {(check.accuracy, check.low, check.high) for check in shared} == {(0.5, 0.5, 0.5)}


def test_a_geometry_that_determines_the_outcome_fails() -> None:
    """Only the twin of every pair remains that falls if and only if its top block is on one side."""
    arrays = synthetic_pairs("blocktower")
    top = (arrays["states"][:, 1, 0, :, 0] * (arrays["object_index"] == 2)).sum(axis=1)
    checks = checks_by_name("blocktower", select(arrays, (top > 0) == np.arange(2 * PAIRS) % 2))
    assert checks["C predicts whether CD stands"].accuracy > 0.9
    assert {"C predicts whether CD stands", "C predicts whether block 2 stays"} <= failing(checks.values())


def test_an_overhang_that_determines_the_outcome_fails() -> None:
    """No single coordinate shows how far the upper block overhangs the lower one, to any side."""
    arrays = synthetic_pairs("blocktower")
    x, y = (
        np.stack([(arrays["states"][:, 1, 0, :, axis] * (arrays["object_index"] == k)).sum(axis=1) for k in (0, 1)])
        for axis in (0, 1)
    )
    far = np.maximum(np.abs(x[1] - x[0]), np.abs(y[1] - y[0])) > 0.35
    assert check_classifier("", initial_scene(arrays, 3), far, arrays["twin"]).accuracy > 0.9


@pytest.mark.parametrize("name", [pytest.param("blocktower", marks=pytest.mark.slow), "collision"])
def test_a_do_operation_that_differs_between_twins_fails(name: str) -> None:
    arrays = synthetic_pairs(name)
    arrays["do_offset"][1::2] *= 3
    lines = failing(checks_by_name(name, arrays).values())
    assert [line for line in lines if line.startswith("the kind and size of the do-operation")]
    assert [line for line in lines if line.startswith("C predicts")]
    assert not [line for line in lines if line.startswith(("colours", "the number"))]


@pytest.mark.parametrize("name", ["blocktower", "collision"])
def test_an_observed_outcome_that_repeats_is_a_fault_of_towers_only(name: str) -> None:
    arrays = select(synthetic_pairs(name), range(PAIRS))
    arrays["states"][:, 0] = arrays["states"][:, 1]
    (check,) = (check for line, check in checks_by_name(name, arrays).items() if line.startswith("the outcome of AB"))
    assert check.accuracy == 1.0
    assert check.passed == (name == "collision")


def test_too_few_pairs_are_skipped() -> None:
    (check,) = check_bias(select(synthetic_pairs("balls"), range(8)), tiny_spec("balls"))
    assert check.result == "skipped: 4 twin pairs are fewer than 5"


@pytest.mark.parametrize("name", ["blocktower", "collision"])
def test_an_order_that_tells_outcomes_or_confounders_is_found(name: str) -> None:
    arrays = synthetic_pairs(name)
    count, rng = len(arrays["twin"]), np.random.default_rng(1)
    shuffled = rng.permutation(count)
    pair = rng.permutation(PAIRS)[arrays["twin"]]
    arrays |= {
        "gravity": np.zeros((count, 3)),
        "split": np.zeros(count),
        "background_seed": rng.permutation(PAIRS)[pair],
    }
    arrays |= {key: np.zeros(arrays["shape"].shape) for key in ("friction", "restitution")}
    arrays["mass"] = np.where(pair[:, None] < PAIRS // 2, 1.0, 2.0) * (arrays["object_index"] >= 0)
    in_random_order = arrays | {"experiment": shuffled, "twin": rng.permutation(PAIRS)[arrays["twin"]]}
    (check,) = check_stored_order(in_random_order, tiny_spec(name))
    assert check.passed, check.result
    as_made = {"experiment": np.arange(count)}  # the second twin moves
    in_blocks = {"twin": pair}  # the first half has other masses
    for fault, value in ((as_made, "AB"), (in_blocks, "mass")):
        (check,) = check_stored_order(in_random_order | fault, tiny_spec(name))
        assert not check.passed
        assert value in check.result
