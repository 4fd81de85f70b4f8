"""What AB can tell about mass and friction of a tower's blocks, however it is read: python benchmarks/identifiability.py

For some towers of three, AB is simulated under all 576 configurations of the confounders, and every configuration is
weighed by how near its AB comes to the one that was seen. The most probable value of each block's mass and friction then
is right as often as printed, for two readers: one whose predictions are off by σ as a whole (weight exp(-d²/2σ²), d the
time-averaged distance of the block that differs most), and one whose errors are independent in every coordinate of every
frame (exp(-Σ‖Δ‖²/2σ²)), which no learned model's are. All configurations count alike beforehand. Half a minute per tower.
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
    found: dict[tuple[str, str, float], list[list[float]]] = {}
    with Simulator() as simulator:
        for pair in tqdm(range(num_towers), unit="tower"):
            experiment = towers.twin_pair(NUM_BLOCKS, seed=0, pair=1000 + 7 * pair, simulator=simulator)[pair // 2 % 2]
            exponents = misfits(towers, experiment, simulator)
            outcome = "stands" if towers.stands(experiment.observed) else "falls"
            for reader, misfit in exponents.items():
                for sigma in SIGMAS_M:
                    weight = np.exp(-(misfit - misfit.min()) / (2 * sigma**2))
                    found.setdefault((outcome, reader, sigma), []).append(certainty(towers, weight / weight.sum()))
    table = Table("A", "errors", "σ, m", "towers", "mass, %", "friction, %", "both (4-way), %")
    for (outcome, reader, sigma), rows in sorted(found.items()):
        table.add_row(outcome, reader, f"{sigma}", str(len(rows)), *(f"{100 * v:.0f}" for v in np.mean(rows, axis=0)))
    Console().print(table)


def misfits(towers: Blocktower, experiment: Experiment, simulator: Simulator) -> dict[str, np.ndarray]:
    """(configuration,) m²: how far AB under every configuration is from the AB that was seen, for both readers."""
    stride = towers.clock.states_per_frame
    trajectories = [
        towers.simulate(simulator, towers.under(configuration, experiment.scene))
        for configuration in range(towers.confounders.num_configurations(NUM_BLOCKS))
    ]
    apart = [(t.positions - experiment.observed.positions)[::stride] for t in trajectories]
    return {
        "as a whole": np.array([trajectory_distance(experiment.observed, t) ** 2 for t in trajectories]),
        "independent": np.array([np.square(difference).sum() for difference in apart]),
    }


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
