"""Is D what physics makes of C, and not what the solver's step makes of it? A sample is simulated at twice the rate."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cophy.dataset.audit.checks import Arrays, Check, by_chance
from cophy.dataset.replay import do_operation_of, scene_of
from cophy.dataset.spec import DatasetSpec
from cophy.scenario import Simulator
from cophy.scenario.physics.scene import trajectory_distance

MAX_MOVED_M = 0.5  # ours: half an object
MIN_SHARE = 0.9  # ours: chaos makes the rest; a few in a hundred change whom they hit


def convergence(arrays: Arrays, spec: DatasetSpec, pairs: int) -> Iterator[Check]:
    """Whether doubling the solver's rate moves D by less than half an object, in nine of ten experiments (up to chance).

    Towers have no limit: that they stand or fall is checked against statics, and how they fall is sensitive.

    Args:
        arrays: of the whole dataset.
        spec: of the dataset.
        pairs: as many experiments as so many twin pairs have, spread over the dataset.
    """
    rows = np.unique(np.linspace(0, len(arrays["twin"]) - 1, 2 * pairs).astype(int)).tolist()
    with Simulator() as simulator:
        moved = np.array(moved_by_twice_the_rate(arrays, spec, rows, simulator))
    share = float((moved < MAX_MOVED_M).mean())
    found = f"half of {len(rows)} CD by less than {np.median(moved):.1e} m, {share:.0%} by less than {MAX_MOVED_M} m"
    sound = spec.scenario.statics is not None or share >= MIN_SHARE - by_chance(MIN_SHARE, len(rows))
    yield Check("twice the solver's rate moves", found, sound)


def moved_by_twice_the_rate(arrays: Arrays, spec: DatasetSpec, rows: list[int], simulator: Simulator) -> list[float]:
    """How far CD moves when the solver takes twice as many steps, metres: averaged over time, of the object that moves most.

    Args:
        arrays: of the whole dataset.
        spec: of the dataset.
        rows: the experiments.
        simulator: they are simulated with it.
    """
    scenario = spec.scenario
    finer = replace(scenario, solver=replace(scenario.solver, step_rate_hz=2 * scenario.solver.step_rate_hz))
    found = []
    for row in rows:
        start = do_operation_of(arrays, row, scenario).apply(scene_of(arrays, row, scenario))
        found.append(trajectory_distance(*(each.simulate(simulator, start) for each in (scenario, finer))))
    return found
