"""What the generator did not make, or what the simulator does not confirm, is named."""

import numpy as np
import pytest

from cophy.audit.data import slots_in_order, states, towers, twins
from cophy.audit.simulated import simulation
from tests.dataset.audit.failing import failing


def failing_of_first_pair(arrays: dict, spec) -> set[str]:
    """What of the simulated checks fails when the first twin pair is made and simulated again."""
    first = {name: array[:2] for name, array in arrays.items()}
    return failing(simulation(first, spec, pairs=1))


def with_state(arrays: dict, coordinate: int, value: float) -> dict:
    """Coordinate of every object in frame 9 of the first CD replaced."""
    changed = arrays["states"].copy()
    changed[0, 1, 9, arrays["presence"][0, 1], coordinate] = value
    return arrays | {"states": changed}


def test_states_that_no_rigid_bodies_have_are_caught(tiny) -> None:
    spec, arrays = tiny
    assert "no sequence gains energy" in failing(states(with_state(arrays, 7, 50.0), spec))
    assert "made again from the seed, the same bytes" in failing_of_first_pair(with_state(arrays, 7, 50.0), spec)
    assert "objects are above the floor, centres at least" in failing(states(with_state(arrays, 2, 0.1), spec))
    if spec.scenario.name != "blocktower":
        assert "objects stay in sight" in failing(states(with_state(arrays, 0, 99.0), spec))


def test_sequences_that_the_simulator_does_not_confirm_are_caught(tiny) -> None:
    """With CD of the twins exchanged; up to chance, a tenth may differ."""
    spec, arrays = tiny
    states = arrays["states"].copy()
    states[:, 1] = states[np.arange(len(states)) ^ 1, 1]  # twins follow each other
    line = "simulated again from the stored A and C, as stored"
    assert line in failing(simulation(arrays | {"states": states}, spec, pairs=8))
    assert line not in failing(simulation(arrays, spec, pairs=8))


def with_confounders_swapped(arrays: dict, one: int, other: int) -> dict:
    """Object by object, in the scenario's order, and with their codes, so that the two agree still."""
    names = ("mass", "friction", "restitution", "gravity", "configuration")
    swapped = {name: arrays[name].copy() for name in names}
    slots = slots_in_order(arrays, int(arrays["object_index"].max()) + 1)
    for here, there in ((one, other), (other, one)):
        for name in names[:3]:
            swapped[name][here, slots[here]] = arrays[name][there, slots[there]]
        for name in names[3:]:
            swapped[name][here] = arrays[name][there]
    return arrays | swapped


@pytest.mark.parametrize("other", [1, 5])
def test_confounders_of_another_experiment_are_caught(tiny, other: int) -> None:
    """Of the twin, or of some other one; also where the experiment is none of those that are simulated again."""
    spec, arrays = tiny
    swapped = with_confounders_swapped(arrays, 0, other)
    assert not failing(states(swapped, spec)) - {"no sequence gains energy"}
    assert "made again from the seed, the same bytes" in failing_of_first_pair(swapped, spec)
    assert "confounders and do-operation are those of the index" in failing(twins(swapped, spec))
    if spec.scenario.name == "blocktower" and other == 1:
        assert "statics agree, under the stored masses and gravity" in failing(
            towers(swapped, spec, spec.scenario.statics)
        )
