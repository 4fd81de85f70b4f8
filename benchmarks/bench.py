"""Speed as ratios within one run: just bench [training|generation|loading|startup|hours ...]

Prints a table and writes outputs/bench-<topic>.json. CPU times of one thread, medians of five pairs; docs/performance.md
says what they mean. `hours` prints what `size=paper` costs.
"""

import json
import sys

import speed_generation
import speed_loading
import speed_startup
import speed_training
import torch
from measure import ROOT, Measured
from rich.console import Console
from rich.table import Table

from cophy import config

TOPICS = {
    "training": speed_training.measure,
    "generation": speed_generation.measure,
    "loading": speed_loading.measure,
    "startup": speed_startup.measure,
}
PAIRS_FOR_HOURS = 10


def main(topics: list[str]) -> None:
    """Measure, print, keep."""
    config.register()
    torch.set_num_threads(1)
    for topic in topics:
        if topic == "hours":
            print_hours()
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


def print_hours() -> None:
    """CPU-seconds per experiment and CPU-hours of `size=paper`."""
    kinds = ["states", *(f"{kind} {size}" for size in speed_generation.RESOLUTIONS for kind in ("rgb", "all"))]
    table = Table("scenario", "objects", "count", *(f"{k}, s" for k in kinds), *(f"{k}, h" for k in kinds))
    for row in speed_generation.hours(PAIRS_FOR_HOURS):
        table.add_row(*row)
    Console(width=180).print(table)


if __name__ == "__main__":
    main(sys.argv[1:] or list(TOPICS))
