"""Does AB tell CD? Confounders that give this AB must not give another CD (paper Sec. 3: confounders are to be read off AB).

A sample of experiments is simulated under other configurations of their confounders, from the true A and initial velocity.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from cophy.dataset.audit.checks import Arrays, Check, tolerance
from cophy.dataset.replay import do_operation_of, scene_of, trajectories_of
from cophy.dataset.spec import DatasetSpec
from cophy.scenario import Scenario, Simulator
from cophy.scenario.physics.scene import Scene, Trajectory, trajectory_distance
from cophy.scenario.physics.simulation_settings import Clock
from cophy.scenario.physics.statics import Combinations
from cophy.scenario.search.towers import tower_of

MAX_ENUMERATED = 1000  # ours: configurations; more of them would take minutes for each twin pair
ALIKE_M = 0.05  # ours: AB of two configurations look alike below this trajectory distance, to eyes that see to 5 cm
BEGINNINGS = (0.2, 0.4)  # ours: shares of AB after which configurations are dropped that cannot look alike any more
MIN_IDENTIFIED = 0.9  # ours: towers that stand in AB, a tenth of all, may leave open how they fall in CD


def identifiability(arrays: Arrays, spec: DatasetSpec, pairs: int) -> Iterator[Check]:
    """How often AB tells CD, over twin pairs that are chosen at random.

    An experiment is identified if every configuration whose AB looks like the true one agrees on CD: its trajectory is
    within `min_difference`, and a tower that stands stands. Where there are too many configurations, those that differ
    from the true one in a single value are tried, and the line has no limit.

    Args:
        arrays: of the whole dataset.
        spec: of the dataset.
        pairs: how many of them.
    """
    chosen = np.sort(np.random.default_rng(0).permutation(len(arrays["twin"]) // 2)[:pairs]).tolist()
    enumerated = spec.scenario.confounders.num_configurations(spec.num_objects) <= MAX_ENUMERATED
    with Simulator() as simulator:
        bar = tqdm(chosen, unit="pair", desc="under other confounders", leave=False)
        found = np.array([agreed for pair in bar for agreed in _agreements(arrays, spec, pair, enumerated, simulator)])
    outcome, trajectory = found.mean(axis=0)
    others = "all configurations" if enumerated else "configurations with one other value"
    text = f"the same CD in {trajectory:.0%} of {len(found)} experiments"
    if spec.scenario.statics is not None:
        text += f", CD stands or falls alike in {outcome:.0%}"
    limit = f" ≥ {MIN_IDENTIFIED:.0%}, up to chance" if enumerated else " (no limit: too many to try all)"
    least = MIN_IDENTIFIED - tolerance(MIN_IDENTIFIED, len(found))
    yield Check(f"AB identifies CD, among {others}", text + limit, bool(not enumerated or trajectory >= least))


def _agreements(
    arrays: Arrays, spec: DatasetSpec, pair: int, enumerated: bool, simulator: Simulator
) -> Iterator[tuple[bool, bool]]:
    """For both twins: whether all configurations with the same AB agree on whether CD stands, and on its trajectory."""
    scenario, rows = spec.scenario, (2 * pair, 2 * pair + 1)
    scene = scene_of(arrays, rows[0], scenario)
    truth = [trajectories_of(arrays, row) for row in rows]
    own = arrays["configuration"][list(rows)].tolist()
    tried = _not_ruled_out(scenario, scene, _all_or_neighbours(spec, own, enumerated), own)
    alike = _alike(scenario, scene, tried, [observed for observed, _ in truth], simulator)
    for row, configurations, (_, counterfactual) in zip(rows, alike, truth, strict=True):
        do_operation = do_operation_of(arrays, row, scenario)
        starts = [do_operation.apply(scenario.under(configuration, scene)) for configuration in configurations]
        yield _same_counterfactual(scenario, starts, counterfactual, simulator)


def _same_counterfactual(
    scenario: Scenario, starts: list[Scene], truth: Trajectory, simulator: Simulator
) -> tuple[bool, bool]:
    """Whether CD from all these C has the true outcome (where outcomes are to stand or to fall), and the true trajectory."""
    outcome = near = True
    for start in starts:
        found = scenario.simulate(simulator, start)
        near = near and trajectory_distance(found, truth) < scenario.min_difference
        if scenario.statics is not None:
            outcome = outcome and scenario.statics.stands(found) == scenario.statics.stands(truth)
        else:
            outcome = near
        if not (outcome or near):
            break
    return outcome, near


def _all_or_neighbours(spec: DatasetSpec, own: list[int], enumerated: bool) -> list[int]:
    grid = spec.scenario.confounders
    if enumerated:
        return list(range(grid.num_configurations(spec.num_objects)))
    return sorted({other for each in own for other in grid.neighbours(each, spec.num_objects)})


def _not_ruled_out(scenario: Scenario, scene: Scene, tried: list[int], own: list[int]) -> list[int]:
    """Without those of which statics say that A stands where it falls under both twins' confounders, or the reverse."""
    if scenario.statics is None:
        return tried
    tower, grid, num_levels = tower_of(scene), scenario.confounders, len(scene.objects)
    confounders = [grid.decode(configuration, num_levels) for configuration in (*own, *tried)]
    tilt = np.array([each.gravity_xy for each in confounders]) / -scenario.gravity_z
    loads = Combinations(np.array([each.mass for each in confounders]), tilt)
    own_stand, stand = np.split(scenario.statics.margins(*tower, loads)[0] > 0, [len(own)])
    return [configuration for configuration, stands in zip(tried, stand, strict=True) if stands in own_stand]


def _alike(
    scenario: Scenario, scene: Scene, tried: list[int], observed: list[Trajectory], simulator: Simulator
) -> list[list[int]]:
    """For each observed sequence, the configurations under which it looks the same; most are dropped after its beginning."""
    kept = tried
    for share in BEGINNINGS:
        clock = replace(scenario.clock, num_frames=max(2, round(share * scenario.clock.num_frames)))
        distance = _distances(scenario, scene, kept, observed, clock, simulator)
        part = clock.num_frames / scenario.clock.num_frames  # distances are means over time
        kept = [c for c, nearest in zip(kept, (part * distance).min(axis=1).tolist(), strict=True) if nearest < ALIKE_M]
    distance = _distances(scenario, scene, kept, observed, scenario.clock, simulator)
    return [[c for c, near in zip(kept, column, strict=True) if near] for column in (distance < ALIKE_M).T]


def _distances(
    scenario: Scenario,
    scene: Scene,
    tried: list[int],
    observed: list[Trajectory],
    clock: Clock,
    simulator: Simulator,
) -> np.ndarray:
    """(configuration, observed sequence) trajectory distances as far as the clock goes, metres."""
    found = np.zeros((len(tried), len(observed)))
    for row, configuration in enumerate(tried):
        start = scenario.under(configuration, scene)
        simulated = simulator.simulate(start, solver=scenario.solver, clock=clock, num_slots=scenario.num_slots)
        for column, each in enumerate(observed):
            beginning = Trajectory(each.states[: len(simulated.states)], each.presence)
            found[row, column] = trajectory_distance(simulated, beginning)
    return found
