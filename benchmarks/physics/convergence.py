"""What finer steps change for balls and collisions."""

import numpy as np
from sections import head_of, scenario, simulated
from tqdm import tqdm

from cophy.scenario import Simulator, Solver
from cophy.scenario.physics import trajectory_distance

NUM_PAIRS = 20
SOLVERS = [Solver(rate, n, True) for rate, n in ((120, 50), (240, 20), (240, 50), (240, 100), (480, 50), (960, 50))]


def convergence(name: str, num_objects: int, simulator: Simulator) -> str:
    """How far trajectories are from those at a four times finer step, against how far twins are apart."""
    chosen = scenario(name)
    experiments = [
        experiment
        for pair in range(NUM_PAIRS)
        for experiment in chosen.twin_pair(num_objects, data_seed=0, pair=pair, simulator=simulator)
    ]
    scenes = [experiment.scene for experiment in experiments]
    twins = [
        trajectory_distance(a.observed, b.observed) for a, b in zip(experiments[::2], experiments[1::2], strict=True)
    ]
    results = {}
    for solver in tqdm(SOLVERS, desc=name):
        rates = (solver.step_rate_hz, solver.iterations)
        results[rates] = simulated(scenes, solver, simulator, num_slots=chosen.num_slots)
    finest = results[(960, 50)][0]
    lines = []
    for (rate, iterations), (trajectories, cost) in results.items():
        distance = [trajectory_distance(a, b) for a, b in zip(trajectories, finest, strict=True)]
        mark = " **(chosen)**" if (rate, iterations) == (chosen.solver.step_rate_hz, chosen.solver.iterations) else ""
        lines.append(
            f"| {rate} Hz, {iterations} iterations{mark} | {np.median(distance):.3f} | {np.quantile(distance, 0.9):.3f} | {cost:.1f} |"
        )
    return "\n".join(
        [
            f"## {name.capitalize()}",
            "",
            f"Observed sequences of {len(scenes)} experiments with {num_objects} objects, compared with the same scenes at 960 Hz.",
            "Distances are averaged over time, of the object that differs most.",
            f"For comparison, twins are {np.median(twins):.2f} m apart in the median.",
            "",
            *head_of(("solver", "median, m", "90 % quantile, m", "CPU-ms per simulated second")),
            *lines,
            "",
        ]
    )
