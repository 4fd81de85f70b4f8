"""A sample of experiments, made again and simulated again, so that nothing hangs on the word of the generator."""

from collections.abc import Iterator

import numpy as np
from tqdm import tqdm

from cophy.dataset.audit.check import Arrays, Check
from cophy.dataset.replay import do_operation_of, scene_of, trajectories_of
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import to_arrays
from cophy.scenario import Simulator
from cophy.scenario.scene import trajectory_distance

WITHIN = 0.9  # share of sequences: towers and cylinders amplify the rounding of stored states, a few to decimetres


def simulation(arrays: Arrays, spec: DatasetSpec, pairs: int) -> Iterator[Check]:
    """Checks on `pairs` twin pairs, chosen at random."""
    scenario, chosen = spec.scenario, np.random.default_rng(0).permutation(len(arrays["twin"]) // 2)[:pairs]
    different, distances, apart = [], [], []
    with Simulator() as simulator:
        for pair in tqdm(np.sort(chosen).tolist(), unit="pair", desc="simulated again", leave=False):
            rows = (2 * pair, 2 * pair + 1)
            made = to_arrays(
                scenario.twin_pair(spec.num_objects, seed=spec.seed, pair=pair, simulator=simulator), rows, spec
            )
            if any(not np.array_equal(made[name], arrays[name][list(rows)]) for name in made):
                different.append(pair)
            outcomes = []
            for row in rows:
                scene = scene_of(arrays, row, scenario)
                again = [scenario.simulate(simulator, s) for s in (scene, do_operation_of(arrays, row).apply(scene))]
                stored = trajectories_of(arrays, row)
                distances += [trajectory_distance(a, b) for a, b in zip(again, stored, strict=True)]
                outcomes.append(again[1])
            apart.append(trajectory_distance(*outcomes))
    found = (
        f"not {len(different)} of {len(chosen)} twin pairs, the first is {different[0]}"
        if different
        else f"{len(chosen)} twin pairs"
    )
    yield Check("made again from the seed, the same bytes", found, not different)
    close = np.array(distances) < scenario.min_difference
    yield Check(
        "simulated again from the stored A and C, as stored",
        f"{close.mean():.0%} of {len(close)} sequences within {scenario.min_difference:g} m, half within {np.median(distances):.1g} m",
        bool(close.mean() >= WITHIN),
    )
    counterfactual = np.array(apart) >= scenario.min_difference * WITHIN
    yield Check(
        "the twin's confounders give another CD", f"{counterfactual.mean():.0%}", bool(counterfactual.mean() >= WITHIN)
    )
