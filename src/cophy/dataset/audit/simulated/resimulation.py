"""A sample of experiments is made again and simulated again, so that the generator need not be trusted."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from cophy.dataset.audit.checks import Arrays, Check, by_chance
from cophy.dataset.replay import do_operation_of, scene_of, trajectories_of
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.store.experiment_arrays import to_arrays
from cophy.scenario import Scenario, Simulator
from cophy.scenario.physics.scene import trajectory_distance

MIN_SHARE = 0.9  # share of sequences: towers and cylinders amplify the rounding of stored states, a few to decimetres


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
    apart = np.array([replay.twins_apart >= MIN_SHARE * spec.scenario.min_difference for replay in replays])
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
    """A check that MIN_SHARE of the sample has to pass, up to chance."""
    return Check(name, found, bool(holds.mean() >= MIN_SHARE - by_chance(MIN_SHARE, holds.size)))
