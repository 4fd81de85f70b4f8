"""A sample of experiments is made again and simulated again, so that the generator need not be trusted.

Is D what physics makes of C, and not what the solver's step makes of it? A sample is simulated at twice the rate.
Does AB tell CD? Confounders that give this AB must not give another CD (paper Sec. 3: confounders are to be read off AB).

A sample of experiments is simulated under other configurations of their confounders, from the true A and initial velocity.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from cophy.audit.checks import Arrays, Check, by_chance
from cophy.dataset.fields import to_arrays
from cophy.dataset.replay import do_operation_of, scene_of, trajectories_of
from cophy.dataset.spec import DatasetSpec
from cophy.scenario import Scenario, Simulator
from cophy.scenario.physics import Clock, Scene, Trajectory, trajectory_distance
from cophy.scenario.statics import Combinations
from cophy.scenario.towers import tower_of

MAX_MOVED_M = 0.5  # ours: half an object
MIN_CONVERGED_SHARE = 0.9  # ours: chaos makes the rest; a few in a hundred change whom they hit


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
    sound = spec.scenario.statics is not None or share >= MIN_CONVERGED_SHARE - by_chance(
        MIN_CONVERGED_SHARE, len(rows)
    )
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


MIN_RESIMULATED_SHARE = (
    0.9  # share of sequences: towers and cylinders amplify the rounding of stored states, a few to decimetres
)


@dataclass
class _Replay:
    """One twin pair, simulated again.

    distance: of AB and CD of both twins from the stored ones, metres. twins_apart: distance between the CD of the twins,
    metres.
    """

    pair: int
    same_bytes: bool
    cells: list[int]
    distance: np.ndarray
    twins_apart: float


def simulation(arrays: Arrays, spec: DatasetSpec, pairs: int) -> Iterator[Check]:
    """Checks on twin pairs that are chosen at random.

    Args:
        arrays: of the whole dataset.
        spec: of the dataset.
        pairs: how many of them.
    """
    chosen = np.sort(np.random.default_rng(0).permutation(len(arrays["twin"]) // 2)[:pairs]).tolist()
    with Simulator() as simulator:
        bar = tqdm(chosen, unit="pair", desc="simulated again", leave=False)
        replays = [_replay(arrays, spec, pair, simulator) for pair in bar]
    different = [replay.pair for replay in replays if not replay.same_bytes]
    found = f"not {len(different)} of {pairs} twin pairs, the first is {different[0]}" if different else "yes"
    yield Check("made again from the seed, the same bytes", found, not different)
    yield _as_stored(replays, spec.scenario)
    apart = np.array([replay.twins_apart >= MIN_RESIMULATED_SHARE * spec.scenario.min_difference for replay in replays])
    yield _mostly("the twin's confounders give another CD", apart, f"{apart.mean():.0%} of {len(replays)} pairs")


def _replay(arrays: Arrays, spec: DatasetSpec, pair: int, simulator: Simulator) -> _Replay:
    scenario, rows = spec.scenario, [2 * pair, 2 * pair + 1]
    made = to_arrays(
        scenario.twin_pair(spec.num_objects, data_seed=spec.data_seed, pair=pair, simulator=simulator), rows, spec
    )
    again = [
        [scenario.simulate(simulator, scene) for scene in (a, do_operation_of(arrays, row, scenario).apply(a))]
        for row, a in ((row, scene_of(arrays, row, scenario)) for row in rows)
    ]
    distance = [
        [trajectory_distance(*both) for both in zip(simulated, trajectories_of(arrays, row), strict=True)]
        for row, simulated in zip(rows, again, strict=True)
    ]
    return _Replay(
        pair=pair,
        same_bytes=all(np.array_equal(made[name], arrays[name][rows]) for name in made),
        cells=arrays["cell"][rows].tolist(),
        distance=np.array(distance),
        twins_apart=trajectory_distance(again[0][1], again[1][1]),
    )


def _as_stored(replays: list[_Replay], scenario: Scenario) -> Check:
    """Stored states are rounded to float32, which a simulation may amplify."""
    distance = np.stack([replay.distance for replay in replays])
    cells = np.array([replay.cells for replay in replays])
    medians = [
        f"{name} {np.median(distance[cells == cell]):.0e} m"
        for cell, name in enumerate(scenario.cells())
        if (cells == cell).any()
    ]
    close = distance < scenario.min_difference
    found = (
        f"{close.mean():.0%} of {close.size} within {scenario.min_difference:g} m; half within: {', '.join(medians)}"
    )
    return _mostly("simulated again from the stored A and C, as stored", close, found)


def _mostly(name: str, holds: np.ndarray, found: str) -> Check:
    """A check that MIN_RESIMULATED_SHARE of the sample has to pass, up to chance."""
    return Check(
        name, found, bool(holds.mean() >= MIN_RESIMULATED_SHARE - by_chance(MIN_RESIMULATED_SHARE, holds.size))
    )
