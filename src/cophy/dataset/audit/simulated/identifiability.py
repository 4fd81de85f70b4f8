"""Does AB tell CD? Confounders that give this AB must not give another CD (paper Sec. 3: confounders are to be read off AB).

A sample of experiments is simulated under other configurations of their confounders, from the true A and initial velocity.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from cophy.dataset.audit.checks import Arrays, Check, by_chance
from cophy.dataset.replay import do_operation_of, scene_of
from cophy.dataset.spec import DatasetSpec
from cophy.scenario import Scenario, Simulator
from cophy.scenario.physics.scene import Scene, Trajectory, trajectory_distance
from cophy.scenario.physics.simulation_settings import Clock
from cophy.scenario.physics.statics import Combinations
from cophy.scenario.search.towers import tower_of

MAX_ENUMERATED = 1000  # ours: configurations; more of them would take minutes for each twin pair
ALIKE_M = 0.05  # ours: AB of two configurations look alike below this trajectory distance, to eyes that see to 5 cm
BEGINNINGS = (0.2, 0.4)  # ours: shares of AB after which configurations are dropped that cannot look alike any more
MIN_IDENTIFIED = 0.9  # ours: a twentieth of all towers stand in AB and fall in CD; how they fall is left open
MIN_OUTCOMES = 0.98  # ours: all by statics, but A and C are stored rounded


def identifiability(arrays: Arrays, spec: DatasetSpec, pairs: int) -> Iterator[Check]:
    """How often AB tells CD, over twin pairs that are chosen at random.

    An experiment is identified if every configuration whose AB looks like the true one agrees on CD: its trajectory is
    within `min_difference`. Of towers it is also asked whether they agree on whether it stands. Where there are too many
    configurations, those that differ from the true one in a single value are tried, and the line has no limit.

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
    yield _line(f"AB identifies CD, among {others}", trajectory, MIN_IDENTIFIED, len(found), enumerated)
    if spec.scenario.statics is not None:
        yield _line(f"AB tells whether CD stands, among {others}", outcome, MIN_OUTCOMES, len(found), enumerated)


def _line(name: str, share: float, least: float, count: int, enumerated: bool) -> Check:
    text = f"in {share:.1%} of {count} experiments"
    limit = f" ≥ {least:.0%}, up to chance" if enumerated else " (no limit: too many to try all)"
    return Check(name, text + limit, bool(not enumerated or share >= least - by_chance(least, count)))


def _agreements(
    arrays: Arrays, spec: DatasetSpec, pair: int, enumerated: bool, simulator: Simulator
) -> Iterator[tuple[bool, bool]]:
    """For both twins: whether all configurations with the same AB agree on whether CD stands, and on its trajectory."""
    scenario, rows = spec.scenario, (2 * pair, 2 * pair + 1)
    scene = scene_of(arrays, rows[0], scenario)
    own = arrays["configuration"][list(rows)].tolist()
    # the truth is simulated from the stored A, too: falls amplify its rounding
    a = [scenario.under(configuration, scene) for configuration in own]
    after = [do_operation_of(arrays, row, scenario).apply(each) for row, each in zip(rows, a, strict=True)]
    truth = [[scenario.simulate(simulator, start) for start in starts] for starts in zip(a, after, strict=True)]
    tried = np.array(_all_or_neighbours(spec, own, enumerated))
    stands, own_stand = _stand(scenario, scene, tried), _stand(scenario, scene, np.array(own))
    falling = _alike(scenario, scene, tried[~stands].tolist(), [observed for observed, _ in truth], simulator)
    standing = tried[stands].tolist()  # towers that stand look alike
    alike = [standing if stand else found for stand, found in zip(own_stand.tolist(), falling, strict=True)]
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


def _stand(scenario: Scenario, scene: Scene, configurations: np.ndarray) -> np.ndarray:
    """(configuration,) bool: where A is a tower that stands, by statics."""
    if scenario.statics is None:
        return np.zeros(len(configurations), dtype=bool)
    confounders = [scenario.confounders.decode(each, len(scene.objects)) for each in configurations.tolist()]
    tilt = np.array([each.gravity_xy for each in confounders]) / -scenario.gravity_z
    loads = Combinations(np.array([each.mass for each in confounders]), tilt)
    return np.asarray(scenario.statics.margins(*tower_of(scene), loads)[0] > 0)


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
