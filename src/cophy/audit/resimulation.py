"""Checks that simulate a sample of experiments again, so that the generator need not be trusted.

- `check_resimulation`: the same seed gives the same bytes, and the stored A and C give the stored sequences.
- `check_convergence`: D follows from the physics of C, and not from the solver's step.
- `check_identifiability`: AB determines CD (paper Sec. 3: confounders can be inferred from AB). Configurations of confounders
  that reproduce AB must not give another CD.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from cophy.audit.checks import Check, three_sigma
from cophy.dataset.features import Arrays
from cophy.dataset.fields import to_arrays
from cophy.dataset.replay import do_operation_of, scene_of, trajectories_of
from cophy.dataset.spec import DatasetSpec
from cophy.scenario import Scenario, Simulator
from cophy.scenario.physics import Clock, Scene, Trajectory, trajectory_distance
from cophy.scenario.statics import Combinations
from cophy.scenario.towers import read_tower

# ours: towers and cylinders amplify the rounding of stored states, a few to decimetres
MIN_RESIMULATED_SHARE = 0.9
MAX_STEP_EFFECT_M = 0.5  # ours: half an object
MIN_CONVERGED_SHARE = 0.9  # ours: the rest is chaotic; in a few of a hundred the objects collide with others
MAX_ENUMERATED = 1000  # ours: configurations; more would take minutes for each twin pair
ALIKE_M = 0.05  # ours: AB of two configurations look the same below this trajectory distance
BEGINNINGS = (0.2, 0.4)  # ours: shares of AB after which configurations are dropped that already look different
MIN_IDENTIFIED = (
    0.9  # ours: a twentieth of all towers stand in AB and fall in CD, and AB does not determine how they fall
)
MIN_OUTCOMES = 0.98  # ours: not 1, because A and C are stored rounded


@dataclass
class _Replay:
    """One twin pair, regenerated and resimulated.

    Attributes:
        distance: (twin, sequence) trajectory distance from the stored sequence, metres.
        twins_distance: trajectory distance between the CD of the twins, metres.
    """

    pair: int
    same_bytes: bool
    cells: list[int]
    distance: np.ndarray
    twins_distance: float


def check_resimulation(arrays: Arrays, spec: DatasetSpec, num_pairs: int) -> Iterator[Check]:
    """Regenerate and resimulate a random sample of twin pairs."""
    with Simulator() as simulator:
        bar = tqdm(_sample_pairs(arrays, num_pairs), unit="pair", desc="resimulated", leave=False)
        replays = [_replay(arrays, spec, pair, simulator) for pair in bar]
    different = [replay.pair for replay in replays if not replay.same_bytes]
    result = "yes"
    if different:
        result = f"fails in {len(different)} of {num_pairs} twin pairs, the first is {different[0]}"
    yield Check("regenerated from the seed, the same bytes", result, not different)
    yield _check_stored(replays, spec.scenario)
    differ = np.array([r.twins_distance >= MIN_RESIMULATED_SHARE * spec.scenario.min_difference for r in replays])
    result = f"{differ.mean():.0%} of {len(replays)} pairs"
    yield _check_most("the twin's confounders change CD", differ, result)


def _sample_pairs(arrays: Arrays, num_pairs: int) -> list[int]:
    pairs: list[int] = np.sort(np.random.default_rng(0).permutation(len(arrays["twin"]) // 2)[:num_pairs]).tolist()
    return pairs


def _replay(arrays: Arrays, spec: DatasetSpec, pair: int, simulator: Simulator) -> _Replay:
    scenario, rows = spec.scenario, [2 * pair, 2 * pair + 1]
    experiments = scenario.twin_pair(spec.num_objects, data_seed=spec.data_seed, pair=pair, simulator=simulator)
    regenerated = to_arrays(experiments, rows, spec)
    resimulated = [
        [scenario.simulate(simulator, scene) for scene in (a, do_operation_of(arrays, row, scenario).apply(a))]
        for row, a in ((row, scene_of(arrays, row, scenario)) for row in rows)
    ]
    distance = [
        [trajectory_distance(*both) for both in zip(simulated, trajectories_of(arrays, row), strict=True)]
        for row, simulated in zip(rows, resimulated, strict=True)
    ]
    return _Replay(
        pair=pair,
        same_bytes=all(np.array_equal(regenerated[name], arrays[name][rows]) for name in regenerated),
        cells=arrays["cell"][rows].tolist(),
        distance=np.array(distance),
        twins_distance=trajectory_distance(resimulated[0][1], resimulated[1][1]),
    )


def _check_stored(replays: list[_Replay], scenario: Scenario) -> Check:
    """Check that the stored A and C give the stored sequences; a simulation may amplify their rounding to float32."""
    distance = np.stack([replay.distance for replay in replays])
    cells = np.array([replay.cells for replay in replays])
    medians = ", ".join(
        f"{name} {np.median(distance[cells == cell]):.0e} m"
        for cell, name in enumerate(scenario.cells())
        if (cells == cell).any()
    )
    close = distance < scenario.min_difference
    result = f"{close.mean():.0%} of {close.size} within {scenario.min_difference:g} m; medians: {medians}"
    return _check_most("resimulated from the stored A and C, as stored", close, result)


def _check_most(name: str, passes: np.ndarray, result: str) -> Check:
    """Check that MIN_RESIMULATED_SHARE of the sample passes, up to chance."""
    limit = MIN_RESIMULATED_SHARE - three_sigma(MIN_RESIMULATED_SHARE, passes.size)
    return Check(name, result, bool(passes.mean() >= limit))


def check_convergence(arrays: Arrays, spec: DatasetSpec, num_pairs: int) -> Iterator[Check]:
    """Check that doubling the solver's rate moves D by less than half an object, in nine of ten experiments (up to chance).

    As many experiments as `num_pairs` twin pairs have are simulated, spread over the dataset. Towers have no limit: whether
    they stand is checked against statics, and how they fall is sensitive.
    """
    rows = np.unique(np.linspace(0, len(arrays["twin"]) - 1, 2 * num_pairs).astype(int)).tolist()
    with Simulator() as simulator:
        distance = np.array(effect_of_double_rate(arrays, spec, rows, simulator))
    share = float((distance < MAX_STEP_EFFECT_M).mean())
    result = f"median of {len(rows)}: {np.median(distance):.1e} m; {share:.0%} less than {MAX_STEP_EFFECT_M} m"
    limit = MIN_CONVERGED_SHARE - three_sigma(MIN_CONVERGED_SHARE, len(rows))
    passed = spec.scenario.statics is not None or share >= limit
    yield Check("effect of twice the solver's rate on CD", result, passed)


def effect_of_double_rate(arrays: Arrays, spec: DatasetSpec, rows: list[int], simulator: Simulator) -> list[float]:
    """Return how far CD of each row moves when the solver takes twice as many steps (trajectory distance, metres)."""
    scenario = spec.scenario
    finer = replace(scenario, solver=replace(scenario.solver, step_rate_hz=2 * scenario.solver.step_rate_hz))
    distances = []
    for row in rows:
        start = do_operation_of(arrays, row, scenario).apply(scene_of(arrays, row, scenario))
        distances.append(trajectory_distance(*(each.simulate(simulator, start) for each in (scenario, finer))))
    return distances


def check_identifiability(arrays: Arrays, spec: DatasetSpec, num_pairs: int) -> Iterator[Check]:
    """Check how often AB determines CD, over a random sample of twin pairs.

    An experiment is identified if every configuration whose AB looks like the true one gives the true CD: its trajectory is
    within `min_difference`. For towers, the configurations must also agree on whether CD stands. Where there are too many
    configurations, those that differ from the true one in a single value are tried, and there is no limit.
    """
    enumerated = spec.scenario.confounders.num_configurations(spec.num_objects) <= MAX_ENUMERATED
    with Simulator() as simulator:
        bar = tqdm(_sample_pairs(arrays, num_pairs), unit="pair", desc="under other confounders", leave=False)
        agreed = np.array([each for pair in bar for each in _agreements(arrays, spec, pair, enumerated, simulator)])
    outcome, trajectory = agreed.mean(axis=0)
    others = "all configurations" if enumerated else "configurations with one other value"
    yield _check_share(f"AB identifies CD, among {others}", trajectory, MIN_IDENTIFIED, len(agreed), enumerated)
    if spec.scenario.statics is not None:
        name = f"AB determines whether CD stands, among {others}"
        yield _check_share(name, outcome, MIN_OUTCOMES, len(agreed), enumerated)


def _check_share(name: str, share: float, minimum: float, count: int, enumerated: bool) -> Check:
    result = f"in {share:.1%} of {count} experiments"
    if not enumerated:
        return Check(name, f"{result} (no limit: too many configurations to try all)", True)
    passed = bool(share >= minimum - three_sigma(minimum, count))
    return Check(name, f"{result} ≥ {minimum:.0%}, up to chance", passed)


def _agreements(
    arrays: Arrays, spec: DatasetSpec, pair: int, enumerated: bool, simulator: Simulator
) -> Iterator[tuple[bool, bool]]:
    """Yield, for both twins, whether all configurations with the same AB agree on whether CD stands, and on its trajectory."""
    scenario, rows, grid = spec.scenario, (2 * pair, 2 * pair + 1), spec.scenario.confounders
    scene = scene_of(arrays, rows[0], scenario)
    true = arrays["configuration"][list(rows)].tolist()
    if enumerated:
        candidates = np.arange(grid.num_configurations(spec.num_objects))
    else:
        candidates = np.array(sorted({other for each in true for other in grid.neighbours(each, spec.num_objects)}))
    # the true sequences are also simulated from the stored A, because falls amplify its rounding
    starts = [scenario.with_configuration(configuration, scene) for configuration in true]
    observed = [scenario.simulate(simulator, start) for start in starts]
    changed = [do_operation_of(arrays, row, scenario).apply(start) for row, start in zip(rows, starts, strict=True)]
    counterfactual = [scenario.simulate(simulator, start) for start in changed]
    stand, true_stand = _stand(scenario, scene, candidates), _stand(scenario, scene, np.array(true))
    falling = _same_observation(scenario, scene, candidates[~stand].tolist(), observed, simulator)
    standing = candidates[stand].tolist()  # towers that stand look the same
    for twin, row in enumerate(rows):
        do_operation = do_operation_of(arrays, row, scenario)
        configurations = standing if true_stand[twin] else falling[twin]
        alternatives = [
            do_operation.apply(scenario.with_configuration(configuration, scene)) for configuration in configurations
        ]
        yield _same_counterfactual(scenario, alternatives, counterfactual[twin], simulator)


def _same_counterfactual(
    scenario: Scenario, starts: list[Scene], true: Trajectory, simulator: Simulator
) -> tuple[bool, bool]:
    """Return whether CD from all starts has the true outcome (towers: stands or falls), and the true trajectory."""
    same_outcome = near = True
    for start in starts:
        trajectory = scenario.simulate(simulator, start)
        near = near and trajectory_distance(trajectory, true) < scenario.min_difference
        if scenario.statics is not None:
            same_outcome = same_outcome and scenario.statics.stands(trajectory) == scenario.statics.stands(true)
        else:
            same_outcome = near
        if not (same_outcome or near):
            break
    return same_outcome, near


def _stand(scenario: Scenario, scene: Scene, configurations: np.ndarray) -> np.ndarray:
    """Return where A is a tower that stands, by statics: (configuration,) bool."""
    if scenario.statics is None:
        return np.zeros(len(configurations), dtype=bool)
    confounders = [scenario.confounders.decode(each, len(scene.objects)) for each in configurations.tolist()]
    tilt = np.array([each.gravity_xy for each in confounders]) / -scenario.gravity_z
    loads = Combinations(np.array([each.mass for each in confounders]), tilt)
    return np.asarray(scenario.statics.margins(*read_tower(scene), loads)[0] > 0)


def _same_observation(
    scenario: Scenario, scene: Scene, candidates: list[int], observed: list[Trajectory], simulator: Simulator
) -> list[list[int]]:
    """Return the configurations under which each observed sequence looks the same; most are dropped after its beginning."""
    for share in BEGINNINGS:
        clock = replace(scenario.clock, num_frames=max(2, round(share * scenario.clock.num_frames)))
        distance = _distances(scenario, scene, candidates, observed, clock, simulator)
        part = clock.num_frames / scenario.clock.num_frames  # distances are means over time
        nearest = (part * distance).min(axis=1).tolist()
        candidates = [c for c, distance_m in zip(candidates, nearest, strict=True) if distance_m < ALIKE_M]
    distance = _distances(scenario, scene, candidates, observed, scenario.clock, simulator)
    return [[c for c, near in zip(candidates, column, strict=True) if near] for column in (distance < ALIKE_M).T]


def _distances(
    scenario: Scenario,
    scene: Scene,
    candidates: list[int],
    observed: list[Trajectory],
    clock: Clock,
    simulator: Simulator,
) -> np.ndarray:
    """Return trajectory distances up to the end of the clock, (configuration, observed sequence), metres."""
    distances = np.zeros((len(candidates), len(observed)))
    for row, configuration in enumerate(candidates):
        start = scenario.with_configuration(configuration, scene)
        simulated = simulator.simulate(start, solver=scenario.solver, clock=clock, num_slots=scenario.num_slots)
        for column, each in enumerate(observed):
            beginning = Trajectory(each.states[: len(simulated.states)], each.presence)
            distances[row, column] = trajectory_distance(simulated, beginning)
    return distances
