"""What size=paper costs: just bench hours prints two Markdown tables. A quarter of an hour on one core.

A few experiments of every dataset are made as generate.py makes them, in one process; its CPU time × the counts of
conf/size/paper.yaml. Experiments are independent of each other: on N cores it takes an N-th of the hours.
"""

import tempfile
import time
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from cophy.app.composition import settings
from cophy.dataset.pictures.images import Images
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.store.shardset import ShardSet
from cophy.dataset.store.states import States
from cophy.scenario import Scenario
from cophy.scenario.rendering.frames import MODALITIES, Backend, RenderSettings

NUM_SIMULATED, NUM_DRAWN = 400, 4  # some searches are long, every picture costs the same
RENDERS = {
    f"{name}, {resolution}": RenderSettings(modalities, resolution, Backend.tiny)
    for resolution in (224, 448)
    for name, modalities in (("RGB", ["rgb"]), ("all", list(MODALITIES)))
}


def main() -> None:
    """Measure, then print."""
    seconds, sizes = {}, {}
    for name in ("blocktower", "balls", "collision"):
        chosen = settings("generate", f"scenario={name}", "size=paper")
        for count, experiments in chosen.size.num_experiments[name].items():
            took = measure(chosen.scenario, int(count))
            key = (f"{name}, {count}", experiments)
            seconds[key] = {what: spent for what, (spent, _) in took.items()}
            sizes[key] = {what: stored for what, (_, stored) in took.items()}
    print("CPU-s per experiment, and CPU-hours of all experiments on one core\n")
    print(table(seconds, per=3600))
    print("\nMiB per experiment, and GiB of all experiments\n")
    print(table(sizes, per=1024))


def measure(scenario: Scenario, num_objects: int) -> dict[str, tuple[float, float]]:
    """CPU-s and MiB per experiment, of the states and of every kind of pictures."""
    with tempfile.TemporaryDirectory() as data_dir:
        simulated, drawn = (
            States(DatasetSpec(scenario, num_objects, one_shard(scenario.name, num_objects, count), 0), Path(data_dir))
            for count in (NUM_SIMULATED, NUM_DRAWN)
        )
        took = {"states": make(simulated)}
        make(drawn)
        drawn.write_manifest()
        return took | {what: make(Images(drawn, render)) for what, render in RENDERS.items()}


def one_shard(name: str, num_objects: int, count: int) -> Size:
    """A size of one dataset in one file.

    Args:
        name: Of the scenario.
        num_objects: In every experiment.
        count: Experiments.
    """
    return Size("measured", count, {name: {str(num_objects): count}})


def make(shards: ShardSet) -> tuple[float, float]:
    """CPU-s and MiB per experiment."""
    shards.directory.mkdir(parents=True, exist_ok=True)
    count, path = shards.spec.num_experiments, shards.path(0)
    with tqdm(total=count, desc=shards.title, leave=False) as bar:

        def advance(done: int) -> None:
            bar.update(done)

        start = time.process_time()
        shards.write(path, 0, advance)
        seconds = time.process_time() - start
    return seconds / count, path.stat().st_size / count / 2**20


def table(each: dict[tuple[str, int], dict[str, float]], *, per: float) -> str:
    """Per dataset and kind: what one experiment takes, and what all take in units of `per`; their sum below."""
    totals = {key: {what: value * key[1] / per for what, value in row.items()} for key, row in each.items()}
    rows = [
        {"dataset": name, "experiments": str(count)}
        | {what: f"{value:.2f}, {totals[name, count][what]:.1f}" for what, value in row.items()}
        for (name, count), row in each.items()
    ]
    summed = {str(what): f"{total:.1f}" for what, total in pd.DataFrame(totals.values()).sum().items()}
    rows.append({"dataset": "together", "experiments": str(sum(count for _, count in each))} | summed)
    return str(pd.DataFrame(rows).to_markdown(index=False))
