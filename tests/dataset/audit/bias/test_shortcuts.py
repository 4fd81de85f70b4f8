"""The classifiers are blind where twins are twins, and not where they are not."""

from collections.abc import Sequence

import numpy as np
import pytest

from cophy.audit.bias import ask_classifier, bias, initial_scene
from cophy.audit.checks import ClassifierCheck
from cophy.scenario import Shape
from tests.conftest import SCENARIOS, tiny_spec

PAIRS = 120
SLOTS = {"blocktower": 4, "balls": 9, "collision": 4}


def made_up(name: str) -> dict[str, np.ndarray]:
    """Twin pairs of random geometry and two states a sequence: in the first twin nothing moves, in the second all do.

    Every second pair has the opposite outcome in AB.
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


def some(arrays: dict[str, np.ndarray], rows: Sequence[int] | np.ndarray) -> dict[str, np.ndarray]:
    return {name: array[rows] for name, array in arrays.items()}


def asked(name: str, arrays: dict[str, np.ndarray]) -> dict[str, ClassifierCheck]:
    checks = list(bias(arrays, tiny_spec(name)))
    assert all(isinstance(check, ClassifierCheck) for check in checks)
    return {check.name: check for check in checks}  # type: ignore[misc]


@pytest.mark.parametrize("name", SCENARIOS)
def test_what_twins_share_tells_exactly_nothing(name: str) -> None:
    found = asked(name, made_up(name))
    assert all(check.passed for check in found.values())
    blind = [check for line, check in found.items() if "observed" not in line and "half of all" not in line]
    assert len(blind) == {"blocktower": 7}.get(name, 4)
    assert {(check.accuracy, check.low, check.high) for check in blind} == {(0.5, 0.5, 0.5)}


def test_a_geometry_that_settles_the_outcome_is_found() -> None:
    """Of every pair the twin is kept that falls where the top block lies far to one side: as if there were no twins."""
    arrays = made_up("blocktower")
    top = (arrays["states"][:, 1, 0, :, 0] * (arrays["object_index"] == 2)).sum(axis=1)
    biased = asked("blocktower", some(arrays, (top > 0) == np.arange(2 * PAIRS) % 2))
    assert biased["C tells whether CD stands"].accuracy > 0.9
    assert not biased["C tells whether CD stands"].passed
    assert not biased["C tells whether block 2 stays"].passed


def test_an_overhang_is_found_to_settle_the_outcome() -> None:
    """What no single coordinate tells: how far the block above reaches beyond the one below, to any side."""
    arrays = made_up("blocktower")
    x, y = (
        np.stack([(arrays["states"][:, 1, 0, :, axis] * (arrays["object_index"] == k)).sum(axis=1) for k in (0, 1)])
        for axis in (0, 1)
    )
    far = np.maximum(np.abs(x[1] - x[0]), np.abs(y[1] - y[0])) > 0.35
    assert ask_classifier("", initial_scene(arrays, 3), far, arrays["twin"]).accuracy > 0.9


@pytest.mark.parametrize("name", ["blocktower", "collision"])
def test_a_do_operation_that_differs_between_twins_is_found(name: str) -> None:
    arrays = made_up(name)
    arrays["do_offset"][1::2] *= 3
    failing = {line for line, check in asked(name, arrays).items() if not check.passed}
    assert {line for line in failing if line.startswith("the do-operation")}
    assert {line for line in failing if line.startswith("C tells")}
    assert not {line for line in failing if line.startswith(("colours", "the number"))}


def test_an_observed_outcome_that_repeats_itself_is_a_fault_of_towers_only() -> None:
    for name in ("blocktower", "collision"):
        arrays = some(made_up(name), range(PAIRS))
        arrays["states"][:, 0] = arrays["states"][:, 1]
        (line,) = (check for line, check in asked(name, arrays).items() if line.startswith("the observed"))
        assert line.accuracy == 1.0
        assert line.passed == (name != "blocktower")


def test_too_few_pairs_are_not_asked() -> None:
    (check,) = bias(some(made_up("balls"), range(8)), tiny_spec("balls"))
    assert check.found == "not asked: 4 twin pairs are fewer than 5"
