"""Twin pairs of all three scenarios, on the tiny datasets and from scratch."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.states import States, to_arrays
from cophy.scenario import Scenario, Simulator
from tests.conftest import SCENARIOS, tiny_spec


def test_observed_and_counterfactual_share_confounders_and_velocities(tiny) -> None:
    _, arrays = tiny
    both = arrays["presence"].all(axis=1)
    a, c = (arrays["states"][:, sequence, 0][both] for sequence in (0, 1))
    np.testing.assert_array_equal(a[:, 3:], c[:, 3:])


def test_only_a_removal_leaves_an_object_out_of_c(tiny) -> None:
    spec, arrays = tiny
    kinds = np.array(spec.scenario.do_operations)[arrays["do_operation"]]
    removed = ~arrays["presence"][range(len(kinds)), 1, arrays["do_slot"]]
    np.testing.assert_array_equal(removed, np.char.startswith(kinds, "remove"))


@pytest.mark.parametrize("name", ["balls", "collision"])
def test_cells_are_level_where_there_is_one_kind_of_block(name: str, tiny_data: Path) -> None:
    arrays = States(tiny_spec(name), tiny_data).load()
    for split in range(3):  # each starts with a block of its own
        assert (
            np.ptp(np.bincount(arrays["cell"][arrays["split"] == split], minlength=len(np.unique(arrays["cell"])))) <= 2
        )


def test_a_single_colour_is_refused(scenario_of: Callable[..., Scenario]) -> None:
    with pytest.raises(ValueError, match="two colours or more"):
        replace(scenario_of("balls"), colors={"red": "#ff0000"}, num_objects=[1])


def test_every_object_of_a_has_a_place_in_the_order(tiny) -> None:
    _, arrays = tiny
    np.testing.assert_array_equal(arrays["presence"][:, 0], arrays["object_index"] >= 0)


def test_other_numbers_of_objects_are_other_scenes(simulator: Simulator, scenario_of) -> None:
    """Else a model trained on four balls would meet balls of its training set where it is tested on two."""
    balls = scenario_of("balls")
    positions = [
        {body.position for body in balls.twin_pair(count, data_seed=0, pair=0, simulator=simulator)[0].scene.objects}
        for count in (3, 4)
    ]
    assert not positions[0] & positions[1]


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_experiment_is_a_pure_function_of_seed_split_and_number(name: str, tiny_data: Path) -> None:
    spec, order = tiny_spec(name), tiny_spec(name).order
    with Simulator() as simulator:
        first, second = (
            spec.scenario.twin_pair(
                spec.num_objects,
                data_seed=spec.data_seed,
                series=int(order.split[place]),
                pair=int(order.number[place]),
                simulator=simulator,
            )[int(order.second[place])]
            for place in (7, 0)
        )
    stored = States(spec, tiny_data).load()
    arrays = to_arrays([first, second], [7, 0], spec)
    for array, expected in ((arrays[key], stored[key]) for key in stored):
        np.testing.assert_array_equal(array, expected[[7, 0]])


@pytest.mark.parametrize(("name", "num_objects"), [("blocktower", 4), ("balls", 2), ("balls", 6)])
def test_other_numbers_of_objects_are_generated_too(name: str, num_objects: int, simulator: Simulator) -> None:
    spec = tiny_spec(name, num_objects)
    first, second = spec.scenario.twin_pair(num_objects, data_seed=3, pair=5, simulator=simulator)
    assert first.observed.presence.sum() == num_objects
    assert first.configuration != second.configuration


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_do_operation_says_its_kind(name: str, scenario_of, simulator: Simulator) -> None:
    scenario: Scenario = scenario_of(name)
    for pair in (0, 2 * len(scenario.cells())):  # of two blocks
        expected = scenario.do_operations[scenario.assignment(SCENARIOS[name], data_seed=0, pair=pair).do_operation]
        twins = scenario.twin_pair(SCENARIOS[name], data_seed=0, pair=pair, simulator=simulator)
        assert [twin.do_operation.kind for twin in twins] == [expected, expected]


def test_a_scenario_says_what_only_some_have(scenario_of) -> None:
    towers, balls, collision = (scenario_of(name) for name in SCENARIOS)
    assert towers.statics.block_size == towers.object_size_m
    assert balls.statics is None
    assert [s.shape_from_positions.name for s in (towers, balls, collision)] == ["BOX", "SPHERE", "SPHERE"]
    assert [s.shapes_of_cell(0) is None for s in (towers, balls, collision)] == [True, True, False]
