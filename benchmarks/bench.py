"""Speed as ratios within one run: just bench [training|generation|loading|startup|profile|hours ...]

Prints a table and writes outputs/bench-<topic>.json. CPU times of one thread, medians of five pairs; docs/benchmark/performance.md
says what they mean. `profile` prints where the time goes, `hours` what `size=paper` costs (a quarter of an hour).
`just bench training against=../cophy-before` compares the training step with that of another checkout, and measures nothing else.
"""

import json
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import hotspots
import paper_size
import speed_generation
import speed_loading
import speed_startup
import speed_training
import torch
from checkouts import compare_checkouts
from measure import ROOT, Measured
from rich.console import Console
from rich.table import Table

from cophy.schemas import register

TOPICS = {
    "training": speed_training.measure,
    "generation": speed_generation.measure,
    "loading": speed_loading.measure,
    "startup": speed_startup.measure,
}
OTHERS = {"profile": hotspots.main, "hours": paper_size.main}
AGAINST = "against="


def main(arguments: list[str]) -> None:
    """Measure, print, keep."""
    topics = [each for each in arguments if not each.startswith(AGAINST)]
    against = [Path(each.removeprefix(AGAINST)) for each in arguments if each.startswith(AGAINST)]
    if unknown := [topic for topic in topics if topic not in TOPICS | OTHERS]:
        sys.exit(f"{unknown[0]}: there are {', '.join(TOPICS | OTHERS)}")
    if against and topics != ["training"]:
        sys.exit(f"{AGAINST} goes with training alone")
    register()
    torch.set_num_threads(1)
    for there in against:
        report("training-against", compare_checkouts.measure(there))
    for topic in () if against else topics or TOPICS:
        if topic in OTHERS:
            OTHERS[topic]()
        else:
            report(topic, TOPICS[topic]())


def report(topic: str, rows: list[Measured]) -> None:
    """A table, and the same as JSON."""
    table = Table("what", "unit", "median", "smallest", "largest", "to reach")
    for row in rows:
        values = (row.median, min(row.ratios), max(row.ratios))
        table.add_row(row.what, row.unit, *(f"{value:.3g}" for value in values), row.reach)
    Console(width=140).print(table)
    path = ROOT / "outputs" / f"bench-{topic}.json"
    path.parent.mkdir(exist_ok=True)
    content = [{**vars(row), "median": row.median} for row in rows]
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("topics", nargs="*", metavar="topic", help=f"{', '.join(TOPICS | OTHERS)}; {AGAINST}CHECKOUT")
    main(parser.parse_args().topics)
