"""What all datasets of `size=paper` cost, extrapolated from some experiments of each: `just bench hours`.

States, and pictures by who looks at them: all frames, AB and C of every experiment, AB and C of test experiments, and the
frames that one de-renderer learns from. For these, floor and backdrop are set up anew for nearly every frame.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from cophy.config import settings
from cophy.dataset.experiment_set import ALL, INPUTS, ChosenFrames, NeededFrames
from cophy.dataset.images import Images
from cophy.dataset.shards import ShardSet
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.splits import FRACTIONS
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering import Backend, RenderSettings

NUM_SIMULATED, NUM_DRAWN = 400, 4  # some searches are long, every picture costs the same
RESOLUTIONS = (112, 224, 448)
ONE_FRAME = ChosenFrames.to_train(np.array([(row, 0, 10) for row in range(NUM_DRAWN)]), "")
DERENDERER_FRAMES = 24_000  # conf/train.yaml: 20,000 to train on, a tenth as many to validate and to test
NEEDED: dict[str, NeededFrames] = {"all": ALL, "AB, C": INPUTS, "one frame": ONE_FRAME}


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
    print("\nCPU-hours of RGB, by who looks at it\n")
    print(by_need(seconds))


def measure(scenario: Scenario, num_objects: int) -> dict[str, tuple[float, float]]:
    """CPU-s and MiB per experiment, of the states and of every kind of pictures; without those that cannot be drawn here."""
    with tempfile.TemporaryDirectory() as data_dir:
        simulated, drawn = (
            States(DatasetSpec(scenario, num_objects, one_shard(scenario.name, num_objects, count), 0), Path(data_dir))
            for count in (NUM_SIMULATED, NUM_DRAWN)
        )
        took = {"states": make(simulated)}
        make(drawn)
        drawn.write_manifest()
        for backend in Backend:
            for resolution in RESOLUTIONS:
                render = RenderSettings(["rgb"], resolution, backend)
                try:
                    took |= {
                        f"{backend.value} {resolution}, {what}": make(Images(drawn, render, needed))
                        for what, needed in NEEDED.items()
                    }
                except CophyError as error:
                    print(error)
        return took


def by_need(seconds: dict[tuple[str, int], dict[str, float]]) -> str:
    """Per dataset and way to draw: hours of all frames, of AB and C of all and of test experiments, of one de-renderer."""
    rows = []
    for (name, count), took in seconds.items():
        for way in dict.fromkeys(what.partition(",")[0] for what in took if what != "states"):
            hours = {what: took[f"{way}, {what}"] * count / 3600 for what in ("all", "AB, C")}
            frames = {
                "all frames": hours["all"],
                "AB, C": hours["AB, C"],
                "AB, C of tests": hours["AB, C"] * FRACTIONS[2],
                "a de-renderer's": min(took[f"{way}, one frame"] * DERENDERER_FRAMES / 3600, hours["all"]),
            }
            rows.append({"dataset": name, "drawn by": way} | {what: f"{value:.2f}" for what, value in frames.items()})
    return str(pd.DataFrame(rows).to_markdown(index=False, disable_numparse=True))


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
