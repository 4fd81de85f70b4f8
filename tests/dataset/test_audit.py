"""The audit passes what is sound and names what is not."""

import numpy as np
import pytest

from cophy.dataset.audit import audit
from cophy.dataset.audit.simulation import simulation
from cophy.dataset.replay import do_operation_of, scene_of
from cophy.dataset.states import to_arrays
from cophy.scenario import Simulator
from tests.conftest import tiny_spec


def failing(arrays: dict, spec, replayed_pairs: int = 1) -> set[str]:
    return {check.name for check in audit(arrays, spec, replayed_pairs=replayed_pairs) if not check.passed}


def test_a_sound_dataset_passes(tiny) -> None:
    spec, arrays = tiny
    assert not failing(arrays, spec, replayed_pairs=8)


@pytest.mark.parametrize(
    ("name", "check"),
    [
        ("states", "states are finite, empty slots zero"),
        ("split", "twins share all but confounders"),
        ("do_slot", "twins share all but confounders"),
        ("split", "train : val : test, by twin pair"),
        ("configuration", "confounders are those of the configuration"),
        ("mass", "confounders are those of the configuration"),
        ("gravity", "confounders are those of the configuration"),
        ("do_offset", "C is A under the do-operation"),
    ],
)
def test_a_planted_fault_is_caught(tiny, name: str, check: str) -> None:
    spec, arrays = tiny
    changed = arrays[name].copy()
    changed[0] = np.nan if name == "states" else changed[0] + 1
    assert check in failing(arrays | {name: changed}, spec)


def test_a_flipped_label_is_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "blocktower":
        pytest.skip("towers only")
    flipped = arrays["stratum"].copy()
    flipped[5] = (flipped[5] + 1) % 4
    assert "labels agree with the trajectories" in failing(arrays | {"stratum": flipped}, spec)


def test_unbalanced_masses_are_caught(tiny) -> None:
    spec, arrays = tiny
    heavy = np.where(arrays["mass"] > 0, 10.0, 0.0)
    assert "share of mass" in failing(arrays | {"mass": heavy}, spec)


def test_tiny_strata_are_exactly_level() -> None:
    spec = tiny_spec("blocktower")
    assert spec.num_experiments % (2 * spec.scenario.num_cells()) == 0


def failing_of_first_pair(arrays: dict, spec) -> set[str]:
    """What of the simulated checks fails when the first twin pair is made and simulated again."""
    first = {name: array[:2] for name, array in arrays.items()}
    return {check.name for check in simulation(first, spec, pairs=1) if not check.passed}


def with_state(arrays: dict, coordinate: int, value: float) -> dict:
    """Coordinate of every object in frame 9 of the first CD replaced."""
    states = arrays["states"].copy()
    states[0, 1, 9, arrays["presence"][0, 1], coordinate] = value
    return arrays | {"states": states}


def test_states_that_no_rigid_bodies_have_are_caught(tiny) -> None:
    spec, arrays = tiny
    assert "no sequence gains energy" in failing(with_state(arrays, 7, 50.0), spec)
    assert "made again from the seed, the same bytes" in failing_of_first_pair(with_state(arrays, 7, 50.0), spec)
    assert "objects are above the floor, centres at least" in failing(with_state(arrays, 2, 0.1), spec)
    if spec.scenario.name != "blocktower":
        assert "objects stay in sight" in failing(with_state(arrays, 0, 99.0), spec)


def test_objects_in_one_place_are_caught(tiny) -> None:
    spec, arrays = tiny
    states = arrays["states"].copy()
    first, second = np.flatnonzero(arrays["presence"][0, 0])[:2]
    states[0, 0, 9, first, :3] = states[0, 0, 9, second, :3]
    assert "objects are apart, centres at least" in failing(arrays | {"states": states}, spec)


def test_confounders_of_another_experiment_are_caught(tiny) -> None:
    spec, arrays = tiny
    swapped = dict(arrays)
    for name in ("mass", "friction", "restitution", "gravity", "configuration"):
        swapped[name] = arrays[name].copy()
        swapped[name][[0, 1]] = arrays[name][[1, 0]]
    assert "made again from the seed, the same bytes" in failing_of_first_pair(swapped, spec)


def test_an_ab_that_tells_nothing_is_caught() -> None:
    """Towers set straight stand under every configuration; their top block moved to the edge, gravity decides (both components: in five of nine cases it falls)."""
    spec = tiny_spec("blocktower")
    with Simulator() as simulator:
        arrays = to_arrays(
            [e for p in range(4) for e in spec.scenario.twin_pair(3, seed=0, pair=p, simulator=simulator)],
            range(8),
            spec,
        )
    arrays["states"][:, :, :, :, :2] = 0.0
    arrays["states"][:, 0] = arrays["states"][:, 0, :1]
    arrays["states"][..., 3:13] = np.where(arrays["presence"][:, :1, None, :, None], [0, 0, 0, 1, 0, 0, 0, 0, 0, 0], 0)
    arrays["presence"][:, 1] = arrays["presence"][:, 0]
    arrays["do_slot"] = arrays["object_index"].argmax(axis=1)
    arrays["do_offset"] = np.tile(np.float32([0.47, 0.47, 0.0]), (8, 1))
    for row in range(8):
        scene = do_operation_of(arrays, row).apply(scene_of(arrays, row, spec.scenario))
        with Simulator() as simulator:
            arrays["states"][row, 1] = spec.scenario.simulate(simulator, scene).states
    (check,) = (c for c in simulation(arrays, spec, pairs=4) if c.name.startswith("AB identifies CD"))
    assert not check.passed
