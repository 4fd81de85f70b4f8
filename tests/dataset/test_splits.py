from typing import Any

import numpy as np
import pytest
import yaml

from cophy.config import CONF, settings
from cophy.dataset.splits import SPLITS, Part, Split, StoredOrder, stored_order
from cophy.errors import CophyError


def order_of(num_experiments: int, **changed: int) -> StoredOrder:
    return stored_order(num_experiments, 100, **({"num_objects": 3, "data_seed": 0} | changed))


def test_splits_are_seven_two_one_and_keep_twins_together() -> None:
    order = order_of(2000)
    assert np.bincount(order.split).tolist() == [1400, 400, 200]
    assert SPLITS == ("train", "val", "test")
    for values in (order.split, order.number):
        assert all(len(np.unique(values[order.pair == pair])) == 1 for pair in range(1000))


def test_every_twin_of_every_pair_is_stored_once_both_in_one_shard() -> None:
    order = order_of(2000)
    made = set(zip(order.split.tolist(), order.number.tolist(), order.second.tolist(), strict=True))
    assert len(made) == 2000
    assert [order.number[order.split == split].max() + 1 for split in range(3)] == [700, 200, 100]
    shards = [set(np.flatnonzero(order.pair == pair) // 100) for pair in range(1000)]
    assert all(len(shard) == 1 for shard in shards)


def test_the_order_is_random() -> None:
    order, other = order_of(2000), order_of(2000, data_seed=1)
    assert (order.number != other.number).mean() > 0.9
    index = np.arange(2000)
    for values in (order.number[order.split == 0], order.second[order.split == 0]):
        assert abs(np.corrcoef(index[order.split == 0], values)[0, 1]) < 0.1
    neighbours = order.pair[1:] == order.pair[:-1]
    assert neighbours.mean() < 0.05, "twins are rarely next to each other"


def test_splits_of_a_small_dataset_are_parts_of_those_of_a_large_one() -> None:
    small, large = (
        {*zip(each.split.tolist(), each.number.tolist(), strict=True)} for each in map(order_of, (200, 2000))
    )
    assert small < large


@pytest.mark.parametrize("tiny", ["collision"], indirect=True)
def test_the_moving_object_selects_its_experiments(tiny) -> None:
    spec, arrays = tiny
    sphere, cylinder = (Part(2, moving=shape).select(arrays, spec.scenario) for shape in ("sphere", "cylinder"))
    np.testing.assert_array_equal(sphere, ~cylinder)
    names = np.array(spec.scenario.cells())[arrays["cell"]]
    np.testing.assert_array_equal(sphere, np.char.startswith(names, "sphere"))


def test_seen_and_unseen_configurations_never_meet(tiny) -> None:
    spec, arrays = tiny
    seen, unseen = (Part(3, configurations=which).select(arrays, spec.scenario) for which in ("seen", "unseen"))
    np.testing.assert_array_equal(seen, ~unseen)
    assert not set(arrays["configuration"][seen]) & set(arrays["configuration"][unseen])
    np.testing.assert_array_equal(seen[::2], seen[1::2])


def test_a_part_that_means_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="neither sphere nor cylinder"):
        Part(2, moving="cube")
    with pytest.raises(ValueError, match="split: configurations=held_out is neither seen nor unseen"):
        Part(2, configurations="held_out")


@pytest.mark.parametrize(("key", "name"), [("cell", "sphere_sphere"), ("do_operation", "displace_moving")])
def test_cells_and_do_operations_are_unknown_in_released_data(key: str, name: str, scenario_of) -> None:
    released = {"split": np.zeros(4, dtype=np.uint8)}
    assert Part(2).select(released, scenario_of("collision")).all()
    with pytest.raises(CophyError, match=f"split: {key} is unknown in released data"):
        Part(2, **{key: name}).select(released, scenario_of("collision"))


def test_every_split_tests_something_at_the_smallest_size(tiny) -> None:
    """So that every table can be tried in seconds."""
    spec, arrays = tiny
    for name in spec.scenario.task.splits:
        keys = yaml.safe_load((CONF / "split" / f"{name}.yaml").read_text())
        split = Split(name, Part(**keys["train"]), Part(**keys["test"]))
        parts = {"train": split.train, "val": split.train, "test": split.test}
        counts = {which: part.select_split(arrays, which, spec.scenario).sum() for which, part in parts.items()}
        assert min(counts.values()) > 0, (name, counts)


def test_every_object_has_one_of_the_values(tiny) -> None:
    spec, arrays = tiny
    grid, present = spec.scenario.confounders, arrays["presence"].any(axis=1)
    heavy, first = Part(3, where={"mass": max(grid.mass)}), Part(3, where={"friction": grid.friction[:2]})
    for row in range(len(arrays["split"])):
        mass, friction = (arrays[name][row, present[row]] for name in ("mass", "friction"))
        assert heavy.select(arrays, spec.scenario)[row] == (mass == np.float32(max(grid.mass))).all()
        assert first.select(arrays, spec.scenario)[row] == np.isin(friction, np.float32(grid.friction[:2])).all()
    both = Part(3, where=heavy.where | first.where).select(arrays, spec.scenario)
    np.testing.assert_array_equal(both, heavy.select(arrays, spec.scenario) & first.select(arrays, spec.scenario))


def test_gravity_cells_and_do_operations_select_experiments(tiny) -> None:
    spec, arrays = tiny
    scenario = spec.scenario
    upright = Part(3, where={"gravity_x": 0}).select(arrays, scenario)
    np.testing.assert_array_equal(upright, arrays["gravity"][:, 0] == 0)
    for key, names in (("cell", scenario.cells()), ("do_operation", scenario.do_operations)):
        for index, name in enumerate(names):
            selected = Part(3, **{key: name}).select(arrays, scenario)
            np.testing.assert_array_equal(selected, arrays[key] == index)
        assert Part(3, **{key: list(names)}).select(arrays, scenario).all()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            {"where": {"masses": [1]}},
            r"split\.train\.where\.masses does not exist; there are mass, friction, restitution, gr",
        ),
        ({"where": {"mass": [1, 7]}}, r"split\.train\.where\.mass=7\.0 does not exist; collision has 1, 2, 5"),
        (
            {"cell": ["sphere_cube"]},
            r"split\.train\.cell=sphere_cube does not exist; collision has sphere_sphere, sphere_cyl",
        ),
        (
            {"do_operation": "remove"},
            r"split\.train\.do_operation=remove does not exist; collision has displace_moving",
        ),
        ({"configurations": "unseen"}, r"split\.train\.configurations=unseen: collision has no unseen configurations"),
    ],
)
def test_what_the_scenario_does_not_have_is_named(keys: dict[str, Any], message: str, scenario_of) -> None:
    split = Split("mine", Part(2, **keys), Part(2), scenario="collision")
    with pytest.raises(CophyError, match=message):
        split.check_scenario(scenario_of("collision"))


def test_a_split_of_the_user_says_its_scenario(scenario_of) -> None:
    Split("mine", Part(2), Part(2), scenario="collision").check_scenario(scenario_of("collision"))
    for scenario in (None, "balls"):
        with pytest.raises(
            CophyError, match=r"split=mine does not go with collision: .*needs the line `scenario: coll"
        ):
            Split("mine", Part(2), Part(2), scenario=scenario).check_scenario(scenario_of("collision"))


def test_splits_of_the_repository_have_the_conditions_that_checkpoints_have_always_stored(scenario_of) -> None:
    for name in ("blocktower", "balls", "collision"):
        for choice in scenario_of(name).task.splits:
            split = settings("generate", f"scenario={name}", f"split={choice}").split
            for part in (split.train, split.test):
                assert part.as_plain().keys() == {"num_objects", "moving", "configurations"}
    assert Part(2, where={"mass": 5}).as_plain() == {**Part(2).as_plain(), "where": {"mass": [5.0]}}
