"""Speed as ratios within one run: just bench [training|generation|loading|startup|report ...]

Prints a table and writes outputs/bench-<topic>.json. CPU times of one thread, medians of several pairs of runs;
docs/contributing.md lists the ratios. Without a topic, all are measured (about 20 minutes).
"""

import json
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter

import speed_generation
import speed_loading
import speed_report
import speed_startup
import speed_training
import torch
from measure import ROOT, Measured
from rich.console import Console
from rich.table import Table

from cophy.schemas import register

TOPICS = {
    "training": speed_training.measure,
    "generation": speed_generation.measure,
    "loading": speed_loading.measure,
    "startup": speed_startup.measure,
    "report": speed_report.measure,
}


def main(topics: list[str]) -> None:
    """Measure the topics one after the other; print and write the results of each."""
    if unknown := set(topics) - set(TOPICS):
        sys.exit(f"{', '.join(sorted(unknown))}: choose among {', '.join(TOPICS)}")
    register()
    torch.set_num_threads(1)
    for topic in topics or TOPICS:
        report(topic, TOPICS[topic]())


def report(topic: str, rows: list[Measured]) -> None:
    """Print the results of a topic as a table, and write them as JSON."""
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
    parser.add_argument("topics", nargs="*", metavar="topic", help=f"any of {', '.join(TOPICS)}")
    main(parser.parse_args().topics)
