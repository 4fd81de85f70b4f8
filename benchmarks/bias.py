"""What the bias probe finds where there is something to find: python benchmarks/bias.py [data_dir]. Towers of size=small.

The geometries C are those of the dataset; the outcomes are planted, by statics, so that the best possible answer is known.
"""

import sys
from pathlib import Path

import numpy as np
from physics import scenario
from rich.console import Console
from rich.table import Table

from cophy import config
from cophy.dataset.audit.bias import probe
from cophy.dataset.audit.clues import initial_scene
from cophy.dataset.audit.towers import stand_on_paper
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.states import States

NUM_OBJECTS = 3
SIZE = Size("small", 100, {"blocktower": {str(NUM_OBJECTS): 4000}})
BROKEN = (0.05, 0.1, 0.2)  # share of twin pairs whose outcomes are alike


def main(data_dir: Path) -> None:
    """Measure, then print."""
    config.register()
    spec = DatasetSpec(scenario("blocktower"), NUM_OBJECTS, SIZE, 0)
    arrays = States(spec, data_dir).load()
    scene, twin, rng = initial_scene(arrays, NUM_OBJECTS), arrays["twin"], np.random.default_rng(0)
    stands = stand_on_paper(arrays, spec, 1)
    mass, gravity_xy = spec.scenario.confounders.masses_and_gravities(NUM_OBJECTS)
    plain = stands[:, (np.ptp(mass, axis=1) == 0) & (gravity_xy == 0).all(axis=1)][:, 0]
    share = stands.mean(axis=1)
    table = Table("planted", "right", "best possible")

    def add(name: str, rows: np.ndarray, outcome: np.ndarray, best: float) -> None:
        table.add_row(name, probe(name, scene[rows], outcome[rows], twin[rows]).found, f"{best:.1%}")

    first = np.arange(0, len(twin), 2)
    drawn = rng.random(len(twin)) < share
    add("no twins, confounders drawn at random", first, drawn, float(np.maximum(share, 1 - share)[first].mean()))
    add("no twins, always equal masses and upright gravity", first, plain, 1.0)
    for broken in BROKEN:
        alike = np.repeat(rng.random(len(first)) < broken, 2)
        opposite = np.arange(len(twin)) % 2 == 0
        outcome = np.where(alike, plain, opposite)
        add(f"{broken:.0%} of twins both as equal masses say", np.arange(len(twin)), outcome, 0.5 + alike.mean() / 2)
    Console().print(table)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "data"))
