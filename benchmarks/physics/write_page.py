"""Write docs/benchmark/physics.md: closed forms, convergence and cost of the solver settings. python benchmarks/physics/write_page.py

Takes about ten minutes on one core. Every number in the document comes from the run that wrote it.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

from closed_forms import closed_forms
from convergence import convergence
from energies import energies
from towers import towers

from cophy.scenario import Simulator
from cophy.schemas import register

ROOT = Path(__file__).parents[2]


def main() -> None:
    """Measure, then write."""
    register()
    with Simulator() as simulator:
        sections = [closed_forms(simulator), towers(simulator)]
        sections += [convergence(name, count, simulator) for name, count in (("balls", 4), ("collision", 2))]
        sections.append(energies(simulator))
    head = (
        "# Physics\n\nDoes the simulation agree with closed forms, and what do more solver steps change?\n"
        "This page is written by `python benchmarks/physics/write_page.py`. CPU times are of one core of the machine it ran on.\n"
        "Compare them with each other.\n"
    )
    (ROOT / "docs" / "benchmark" / "physics.md").write_text("\n".join([head, *sections]))


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
