"""Every check of a dataset's arrays fails on the fault that it is for, and passes without."""

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cophy.audit.checks import (
    SAME_SCENE_M,
    check_cell_shapes,
    check_effects,
    check_first_frames,
    check_shares,
    check_states,
    check_towers,
    check_twins,
    share_with_effect,
)
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States, slots_in_order, sort_by_twins
from tests.audit.failing import failing
from tests.conftest import tiny_spec

Dataset = tuple[DatasetSpec, dict[str, Any]]


def dataset(name: str, tiny_data: Path) -> Dataset:
    spec = tiny_spec(name)
    return spec, sort_by_twins(States(spec, tiny_data).load(), spec)


@pytest.fixture(scope="module")
def towers(tiny_data: Path) -> Dataset:
    return dataset("blocktower", tiny_data)


@pytest.fixture(scope="module")
def collisions(tiny_data: Path) -> Dataset:
    return dataset("collision", tiny_data)


def test_generated_data_pass(tiny) -> None:
    spec, arrays = tiny
    checks = [
        check(arrays, spec) for check in (check_states, check_twins, check_shares, check_cell_shapes, check_effects)
    ]
    if spec.scenario.statics is not None:
        checks.append(check_towers(arrays, spec, spec.scenario.statics))
    assert not failing(itertools.chain(*checks, check_first_frames(arrays, spec.num_objects)))


@pytest.mark.parametrize(
    ("name", "check", "line"),
    [
        ("split", check_twins, "twins share everything except confounders"),
        ("do_slot", check_twins, "twins share everything except confounders"),
        ("split", check_twins, "train : val : test, by twin pair"),
        ("cell", check_twins, "confounders, do-operation and cell follow from the seed"),
        ("configuration", check_states, "confounders match the configuration"),
        ("mass", check_states, "confounders match the configuration"),
        ("gravity", check_states, "confounders match the configuration"),
        ("do_offset", check_states, "C equals A after the do-operation"),
    ],
)
def test_a_wrong_value_of_the_first_experiment_fails(tiny, name: str, check: Any, line: str) -> None:
    spec, arrays = tiny
    changed = arrays[name].copy()
    changed[0] = changed[0] + 1
    assert line in failing(check(arrays | {name: changed}, spec))


@pytest.mark.parametrize(
    ("name", "index", "value", "line"),
    [
        ("seen", (5,), None, "confounders, do-operation and cell follow from the seed"),
        ("gravity", (5, 2), -5.0, "confounders match the configuration"),
        ("mass", None, 10.0, "states are finite, empty slots zero"),
    ],
)
def test_a_wrong_value_of_a_second_twin_fails(collisions, name: str, index: Any, value: Any, line: str) -> None:
    spec, arrays = collisions
    changed = arrays[name].copy()
    index = index or (5, int(np.argmin(arrays["object_index"][5])))  # an empty slot
    changed[index] = ~changed[index] if value is None else value
    arrays = arrays | {name: changed}
    assert line in failing([*check_states(arrays, spec), *check_twins(arrays, spec)])


def test_a_failed_check_names_the_experiment_by_its_id(collisions) -> None:
    spec, arrays = collisions
    changed = arrays["do_offset"].copy()
    changed[5] += 1.0
    (result,) = (
        c.result for c in check_states(arrays | {"do_offset": changed}, spec) if c.name.startswith("C equals A")
    )
    assert result == f"fails in 1 experiments, the first is {arrays['experiment'][5]}"
    assert arrays["experiment"][5] != 5  # a row of arrays that are sorted by twins is no id


def test_twins_of_one_outcome_fail(tiny) -> None:
    spec, arrays = tiny
    for sequence in (0, 1):
        changed = arrays["states"].copy()
        changed[5, sequence] = changed[4, sequence]
        assert failing(check_twins(arrays | {"states": changed}, spec)) == {
            "smallest difference between twins, AB and CD"
        }


def with_state(arrays: dict, coordinate: int, value: float) -> dict:
    """Replace a coordinate of every object in state 9 of the first CD."""
    changed = arrays["states"].copy()
    changed[0, 1, 9, arrays["presence"][0, 1], coordinate] = value
    return arrays | {"states": changed}


def test_states_that_rigid_bodies_cannot_have_fail(tiny) -> None:
    spec, arrays = tiny
    assert "no sequence gains energy" in failing(check_states(with_state(arrays, 7, 50.0), spec))
    assert "objects are above the floor, lowest centre" in failing(check_states(with_state(arrays, 2, 0.1), spec))
    if spec.scenario.name != "blocktower":
        assert "objects stay in view" in failing(check_states(with_state(arrays, 0, 99.0), spec))
    changed = arrays["states"].copy()
    first, second = np.flatnonzero(arrays["presence"][0, 0])[:2]
    changed[0, 0, 9, first, :3] = changed[0, 0, 9, second, :3]
    assert "objects do not overlap, nearest centres" in failing(check_states(arrays | {"states": changed}, spec))


def test_the_view_is_a_square_for_balls_and_a_disc_for_collisions(tiny) -> None:
    spec, arrays = tiny
    changed = arrays["states"].copy()
    present = np.flatnonzero(arrays["presence"][0, 1])
    changed[0, 1, :, present, :2] = 0.9 * getattr(spec.scenario, "extent", 0.0)
    failed = "objects stay in view" in failing(check_states(arrays | {"states": changed}, spec))
    assert failed == (spec.scenario.name == "collision")


def test_held_out_confounders_in_training_fail_however_rotated_and_scaled(towers) -> None:
    spec, arrays = towers
    line = "seen and unseen (†) masses × gravity, up to symmetry and scale"
    slots = slots_in_order(arrays, spec.num_objects)
    seen, unseen = (int(np.flatnonzero(arrays["seen"] == half)[0]) for half in (True, False))
    mass, gravity = arrays["mass"].copy(), arrays["gravity"].copy()
    mass[unseen, slots[unseen]] = 10 * arrays["mass"][seen, slots[seen]]
    gravity[unseen, :2] = -arrays["gravity"][seen, 1::-1]
    assert line in failing(check_twins(arrays | {"mass": mass, "gravity": gravity}, spec))


def test_unequal_shares_fail(tiny) -> None:
    spec, arrays = tiny
    heavy = np.where(arrays["mass"] > 0, 10.0, 0.0)
    lines = failing(check_shares(arrays | {"mass": heavy, "cell": np.zeros_like(arrays["cell"])}, spec))
    assert "share of mass" in lines
    assert ("share of cells" in lines) == (len(spec.scenario.cells()) > 1)


def test_shapes_of_another_cell_fail(collisions) -> None:
    spec, arrays = collisions
    for name in ("cell", "shape"):
        changed = arrays[name].copy()
        changed[5] = (changed[5] + 1) % 4 if name == "cell" else np.where(changed[5] > 0, 5 - changed[5], 0)
        assert "shapes match the cell" in failing(check_cell_shapes(arrays | {name: changed}, spec))


def test_d_that_equals_b_fails(collisions) -> None:
    spec, arrays = collisions
    changed = arrays["states"].copy()
    changed[4, 1] = changed[4, 0]
    assert failing(check_effects(arrays | {"states": changed}, spec)) == {"the do-operation has an effect"}


def test_an_effect_on_the_displaced_object_alone_is_told_apart(tiny) -> None:
    spec, arrays = tiny
    changed = arrays["states"].copy()
    changed[:, 1] = changed[:, 0]
    changed[range(len(changed)), 1, :, arrays["do_slot"], 0] += 2 * spec.scenario.min_difference
    arrays = arrays | {"states": changed}
    present = arrays["presence"][range(len(changed)), 1, arrays["do_slot"]]
    assert share_with_effect(arrays, spec) == present.mean()
    assert share_with_effect(arrays, spec, on_changed_object=False) == 0


def test_a_first_frame_of_another_split_fails_whatever_its_colours(tiny) -> None:
    """A of a training experiment, with objects in other slots and another order, moved by a tenth of the tolerance."""
    spec, arrays = tiny
    train, test = (np.flatnonzero(arrays["split"] == split)[:2] for split in (0, 2))
    copied = {name: array.copy() for name, array in arrays.items()}
    for name in ("object_index", "shape"):
        copied[name][test] = np.roll(arrays[name][train], 1, axis=1)
    index = copied["object_index"][test]
    copied["object_index"][test] = np.where(index < 0, index, spec.num_objects - 1 - index)
    copied["presence"][test, 0] = np.roll(arrays["presence"][train, 0], 1, axis=1)
    copied["states"][test, 0] = np.roll(arrays["states"][train, 0], 1, axis=2)
    copied["states"][test, 0, ..., :2] += SAME_SCENE_M / 10
    assert "no A or C occurs in two splits" in failing(check_first_frames(copied, spec.num_objects))
    (check,) = check_first_frames(copied, spec.num_objects)
    later, earlier = map(int, re.findall(r"\d+", check.result.partition("experiments")[2]))
    assert later in arrays["experiment"][test]
    assert earlier in arrays["experiment"][np.isin(arrays["twin"], arrays["twin"][train])]  # twins share A
    copied["states"][test, 0, ..., :2] += 0.05
    assert not failing(check_first_frames(copied, spec.num_objects))


def another_cell(arrays: dict) -> None:
    arrays["cell"][5] = (arrays["cell"][5] + 1) % 4


def standing_a(arrays: dict) -> None:
    """A of the first twins stands whatever the confounders."""
    arrays["states"][:2, 0] = arrays["states"][:2, 0, :1]


def standing_twins(arrays: dict) -> None:
    arrays["states"][6:8, 1] = arrays["states"][6:8, 1, :1]


def straight_a(arrays: dict) -> None:
    """A straight tower stands under all confounders, so that it reveals nothing about them."""
    arrays["states"][:, 0, :, :, :2] = 0.0


def floating_block(arrays: dict) -> None:
    """The top block stays where both A fall."""
    both_fall = np.char.startswith(np.array(tiny_spec("blocktower").scenario.cells())[arrays["cell"]], "both_fall")
    rows, slots = np.nonzero((arrays["object_index"] == 2) & both_fall[:, None])
    arrays["states"][rows, 0, :, slots] = arrays["states"][rows, 0, :1, slots]


@pytest.mark.parametrize(
    ("fault", "line"),
    [
        (another_cell, "cells match the trajectories"),
        (standing_a, "no A stands under both twins' confounders"),
        (standing_twins, "twins have opposite outcomes of CD"),
        (straight_a, "by statics, AB determines whether CD stands"),
        (floating_block, "blocks of A that must fall by statics fall"),
    ],
)
def test_tower_outcomes_that_do_not_agree_fail(towers, fault: Any, line: str) -> None:
    spec, arrays = towers
    changed = arrays | {name: arrays[name].copy() for name in ("cell", "states")}
    fault(changed)
    assert line in failing(check_towers(changed, spec, spec.scenario.statics))
