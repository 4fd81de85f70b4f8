"""What the classifiers of the audit find where there is something to find: python benchmarks/dataset/bias.py [data_dir]. Towers of size=small.

The geometries C are those of the dataset; the outcomes are planted, by statics, so that the best possible answer is known.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from cophy.audit.bias import ask_classifier, initial_scene
from cophy.audit.data import falls_from_on_paper
from cophy.config import settings
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.states import States
from cophy.scenario import Scenario
from cophy.schemas import register

NUM_OBJECTS = 3
SIZE = Size("small", 100, {"blocktower": {str(NUM_OBJECTS): 4000}})
BROKEN = (0.05, 0.1, 0.2)  # share of twin pairs whose outcomes are alike


class Planted(NamedTuple):
    """A question whose best possible answer is known.

    Attributes:
        name: Of the row.
        rows: The experiments that are asked about.
        outcome: (experiment,) bool, what is asked for.
        best: Share that the best classifier can have right.
    """

    name: str
    rows: np.ndarray
    outcome: np.ndarray
    best: float


def main(data_dir: Path) -> None:
    """Measure, then print."""
    register()
    spec = DatasetSpec(settings("generate", "scenario=blocktower").scenario, NUM_OBJECTS, SIZE, 0)
    arrays = States(spec, data_dir).load()
    scene, twin = initial_scene(arrays, NUM_OBJECTS), arrays["twin"]
    table = Table("planted", "right", "best possible")
    for name, rows, outcome, best in planted(arrays, spec.scenario):
        found = ask_classifier(name, scene[rows], outcome[rows], twin[rows]).found
        table.add_row(name, found, f"{best:.1%}")
    Console().print(table)


def planted(arrays: dict[str, np.ndarray], scenario: Scenario) -> Iterator[Planted]:
    """Outcomes that statics say of the geometries C."""
    statics, rng = scenario.statics, np.random.default_rng(0)
    assert statics is not None
    _, stands = falls_from_on_paper(arrays, statics, 1)
    mass, gravity_xy = scenario.confounders.masses_and_gravities(NUM_OBJECTS)
    plain = stands[:, (np.ptp(mass, axis=1) == 0) & (gravity_xy == 0).all(axis=1)][:, 0]
    share, every = stands.mean(axis=1), np.arange(len(stands))
    first, drawn = every[::2], rng.random(len(every)) < share
    best = float(np.maximum(share, 1 - share)[first].mean())
    yield Planted("no twins, confounders drawn at random", first, drawn, best)
    yield Planted("no twins, always equal masses and upright gravity", first, plain, 1.0)
    for broken in BROKEN:
        alike = np.repeat(rng.random(len(first)) < broken, 2)
        outcome = np.where(alike, plain, every % 2 == 0)
        yield Planted(f"{broken:.0%} of twins both as equal masses say", every, outcome, 0.5 + alike.mean() / 2)


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("data_dir", nargs="?", type=Path, default=Path("data"), help="where the dataset lies")
    main(**vars(parser.parse_args()))
