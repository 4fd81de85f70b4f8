"""Speed as ratios within one run: just bench [training|generation|loading|startup|report|gpu ...]

Prints a table and writes outputs/bench-<topic>.json. CPU times of one thread, medians of several pairs of runs;
docs/contributing.md lists the ratios. Without a topic, all but gpu are measured (about 20 minutes).
"""

import json
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterable

import speed_generation
import speed_gpu
import speed_loading
import speed_report
import speed_startup
import speed_training
import torch
from measure import ROOT, Measured
from rich.console import Console
from rich.table import Table

from cophy.schemas import register

TOPICS: dict[str, Callable[[], Iterable[Measured]]] = {
    "training": speed_training.measure,
    "generation": speed_generation.measure,
    "loading": speed_loading.measure,
    "startup": speed_startup.measure,
    "report": speed_report.measure,
    "gpu": speed_gpu.measure,
}


def main(topics: list[str]) -> None:
    """Measure the topics one after the other; print and write the results of each."""
    if unknown := set(topics) - set(TOPICS):
        sys.exit(f"{', '.join(sorted(unknown))}: choose among {', '.join(TOPICS)}")
    register()
    torch.set_num_threads(1)
    for topic in topics or [topic for topic in TOPICS if topic != "gpu"]:
        report(topic, TOPICS[topic]())


def report(topic: str, rows: Iterable[Measured]) -> None:
    """Print the results of a topic as a table, and write them as JSON, each as it comes."""
    table = Table("what", "unit", "median", "smallest", "largest", "to reach")
    path = ROOT / "outputs" / f"bench-{topic}.json"
    path.parent.mkdir(exist_ok=True)
    content = []
    for row in rows:
        values = (row.median, min(row.ratios), max(row.ratios))
        table.add_row(row.what, row.unit, *(f"{value:.3g}" for value in values), row.reach)
        content.append({**vars(row), "median": row.median})
        path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n")
    Console(width=140).print(table)


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("topics", nargs="*", metavar="topic", help=f"any of {', '.join(TOPICS)}")
    main(parser.parse_args().topics)
