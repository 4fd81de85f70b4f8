"""Where the time goes: generation by cProfile, an epoch of CoPhyNet and one of the de-renderer by torch.profiler."""

import cProfile
import pstats
import tempfile
from collections.abc import Callable
from pathlib import Path

from measure import NUM_OBJECTS, settings
from rich.console import Console
from rich.table import Table
from speed_generation import RESOLUTION, made_states
from speed_loading import NUM_EXPERIMENTS, derendering_step, frame_data
from speed_training import network, random_batch, training_step
from torch.profiler import ProfilerActivity, profile

from cophy.dataset.counterfactual import CounterfactualDataset
from cophy.dataset.images import Images
from cophy.scenario.physics import import_pybullet
from cophy.scenario.rendering import MODALITIES, Backend, RenderSettings

ROWS = 10


def main() -> None:
    """Print all profiles."""
    import_pybullet()  # else its import is the first thing seen
    for name, count in NUM_OBJECTS.items():
        with tempfile.TemporaryDirectory() as directory:
            spent = functions(
                lambda name=name, count=count, d=directory: made_states(name, count, 80, Path(d), per_shard=80)
            )
            show(f"generating {name}, {count} objects", spent)
    with tempfile.TemporaryDirectory() as directory:
        images = Images(made_states("blocktower", 3, 4, Path(directory)), _render_settings())
        images.directory.mkdir()
        images.write(images.path(0), 0, lambda done: None)
        drawn = functions(lambda: images.write(images.path(1), 1, lambda done: None))
        show(f"drawing blocktower, {RESOLUTION} pixels", drawn)
    show("an epoch of CoPhyNet, towers", operators(cophynet_epoch()))
    with tempfile.TemporaryDirectory() as directory:
        data = frame_data(Path(directory))
        step = derendering_step(data)
        show("an epoch of the de-renderer", operators(lambda: [step(batch) for batch in data.train_dataloader()]))


def cophynet_epoch() -> Callable[[], object]:
    """At the default batch size."""
    batch_size, model = settings("train").training.batch_size, network()
    data, step = CounterfactualDataset(random_batch(NUM_EXPERIMENTS, 4, 3)), training_step(model, model)
    return lambda: [step(batch) for batch in data.loader(batch_size, shuffle=True)]


def functions(run: Callable[[], object]) -> list[tuple[str, int, float]]:
    """(name, calls, s) of Python's functions, without what they call."""
    profiler = cProfile.Profile()
    profiler.runcall(run)
    return [
        (f"{Path(file).name}: {name}" if line else name, calls, own)
        for (file, line, name), (_, calls, own, _, _) in pstats.Stats(profiler).stats.items()  # type: ignore[attr-defined]
    ]


def operators(run: Callable[[], object]) -> list[tuple[str, int, float]]:
    """(name, calls, s) of PyTorch's operators, without what they call."""
    with profile(activities=[ProfilerActivity.CPU]) as profiler:
        run()
    return [(event.key, event.count, event.self_cpu_time_total / 1e6) for event in profiler.key_averages()]


def show(title: str, spent: list[tuple[str, int, float]]) -> None:
    """The longest, as a table."""
    total = sum(seconds for _, _, seconds in spent)
    table = Table("what", "calls", "share", title=f"{title}: {total:.1f} s", title_justify="left")
    for name, calls, seconds in sorted(spent, key=lambda row: -row[2])[:ROWS]:
        table.add_row(name, f"{calls:,}", f"{seconds / total:.1%}")
    Console(width=110).print(table)


def _render_settings() -> RenderSettings:
    return RenderSettings(list(MODALITIES), RESOLUTION, Backend.tiny)
