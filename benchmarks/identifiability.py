"""What AB can tell about mass and friction of a tower's blocks, however it is read: python benchmarks/identifiability.py

For some towers of three, AB is simulated under all 576 configurations of the confounders. A reader who predicts
trajectories to within σ weighs every configuration with exp(-d²/2σ²), d its distance to the AB that was seen; the most
probable value of each block's mass and friction then is right as often as printed. No probe of any model that predicts
no better can do better in expectation. Takes half a minute per tower.
"""

import sys

import numpy as np
from physics import scenario
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from cophy import config
from cophy.scenario import Blocktower, Experiment, Simulator
from cophy.scenario.scene import trajectory_distance

SIGMAS_M = (0.01, 0.03, 0.1)
NUM_BLOCKS = 3


def main(num_towers: int) -> None:
    """Print the table."""
    config.register()
    towers = scenario("blocktower")
    found: dict[tuple[float, str], list[list[float]]] = {}
    with Simulator() as simulator:
        for pair in tqdm(range(num_towers), unit="tower"):
            experiment = towers.twin_pair(NUM_BLOCKS, seed=0, pair=1000 + 7 * pair, simulator=simulator)[pair // 2 % 2]
            distance = distances(towers, experiment, simulator)
            outcome = "stands" if towers.stands(experiment.observed) else "falls"
            for sigma in SIGMAS_M:
                weight = np.exp(-((distance / sigma) ** 2) / 2)
                found.setdefault((sigma, outcome), []).append(certainty(towers, weight / weight.sum()))
    table = Table("trajectories predicted to within, m", "A", "towers", "mass, %", "friction, %", "both (4-way), %")
    for (sigma, outcome), rows in sorted(found.items(), key=lambda item: (item[0][1], item[0][0])):
        table.add_row(f"{sigma}", outcome, str(len(rows)), *(f"{100 * value:.0f}" for value in np.mean(rows, axis=0)))
    Console().print(table)


def distances(towers: Blocktower, experiment: Experiment, simulator: Simulator) -> np.ndarray:
    """(configuration,) metres between the AB that was seen and AB under every configuration."""
    return np.array(
        [
            trajectory_distance(experiment.observed, towers.simulate(simulator, towers.under(c, experiment.scene)))
            for c in range(towers.confounders.num_configurations(NUM_BLOCKS))
        ]
    )


def certainty(towers: Blocktower, weight: np.ndarray) -> list[float]:
    """Probability of the most probable mass, friction, and both together; mean over blocks."""
    grid = towers.confounders
    values = [grid.decode(configuration, NUM_BLOCKS) for configuration in range(len(weight))]
    mass, friction = (np.array([getattr(value, name) for value in values]) for name in ("mass", "friction"))
    of_mass = np.stack([weight @ (mass == m) for m in grid.mass])
    of_friction = np.stack([weight @ (friction == f) for f in grid.friction])
    of_both = np.stack([weight @ ((mass == m) & (friction == f)) for m in grid.mass for f in grid.friction])
    return [float(share.max(axis=0).mean()) for share in (of_mass, of_friction, of_both)]


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 24)
