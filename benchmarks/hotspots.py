"""Where the time goes: generation by cProfile, an epoch of CoPhyNet and one of the de-renderer by torch.profiler."""

import cProfile
import pstats
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from measure import NUM_OBJECTS
from rich.console import Console
from rich.table import Table
from speed_generation import RESOLUTION, draw, made_states
from speed_loading import derendering_step, epoch, epoch_of_towers, frame_data
from speed_training import network, training_step
from torch.profiler import ProfilerActivity, profile

from cophy.dataset.images import Images
from cophy.scenario.rendering import MODALITIES, Backend, RenderSettings
from cophy.scenario.simulator import import_pybullet

NUM_SHOWN = 10
Spent = tuple[str, int, float]  # name, calls, s without what it calls in turn


def main() -> None:
    """Print all profiles."""
    import_pybullet()  # else its import is the first thing seen
    for name, count in NUM_OBJECTS.items():
        show(f"generating {name}, {count} objects", generating(name, count))
    show(f"drawing blocktower, {RESOLUTION} pixels", drawing())
    model = network()
    show("an epoch of CoPhyNet, towers", operators(epoch(epoch_of_towers(), training_step(model, model))))
    show("an epoch of the de-renderer", derendering())


def generating(name: str, num_objects: int) -> list[Spent]:
    """80 experiments in one shard."""
    with tempfile.TemporaryDirectory() as directory:
        return functions(partial(made_states, name, num_objects, 80, Path(directory), per_shard=80))


def drawing() -> list[Spent]:
    """A shard of two experiments, after one that does not count."""
    with tempfile.TemporaryDirectory() as directory:
        render = RenderSettings(list(MODALITIES), RESOLUTION, Backend.tiny)
        images = Images(made_states("blocktower", 3, 4, Path(directory)), render)
        draw(images, 0)
        return functions(lambda: draw(images, 1))


def derendering() -> list[Spent]:
    """An epoch with two workers."""
    with tempfile.TemporaryDirectory() as directory:
        data = frame_data(Path(directory))
        step = derendering_step(data)
        return operators(lambda: [step(batch) for batch in data.train_dataloader()])


def functions(run: Callable[[], object]) -> list[Spent]:
    """What was spent in Python's functions."""
    profiler = cProfile.Profile()
    profiler.runcall(run)
    return [
        (f"{Path(file).name}: {name}" if line else name, calls, own)
        for (file, line, name), (_, calls, own, _, _) in pstats.Stats(profiler).stats.items()  # type: ignore[attr-defined]
    ]


def operators(run: Callable[[], object]) -> list[Spent]:
    """What was spent in PyTorch's operators."""
    with profile(activities=[ProfilerActivity.CPU]) as profiler:
        run()
    return [(event.key, event.count, event.self_cpu_time_total / 1e6) for event in profiler.key_averages()]


def show(title: str, spent: list[Spent]) -> None:
    """The longest, as a table."""
    total = sum(seconds for _, _, seconds in spent)
    table = Table("what", "calls", "share", title=f"{title}: {total:.1f} s", title_justify="left")
    for name, calls, seconds in sorted(spent, key=lambda row: -row[2])[:NUM_SHOWN]:
        table.add_row(name, f"{calls:,}", f"{seconds / total:.1%}")
    Console(width=110).print(table)
