"""A small world of all that the commands write: data, pictures, estimates, runs, a report and an exported tree."""

import hashlib
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.commands import run

TIMES = {"training_seconds", "wall_seconds", "resumed"}  # of metrics.json; all else is the same each time
SAME = {".h5", ".csv", ".npz", ".npy", ".mp4", ".txt", ".tex"}  # files that are the same to the byte


@dataclass(frozen=True)
class Step:
    """A command: its script and words, in which {world} stands for the world's folder."""

    name: str
    script: str
    words: tuple[str, ...]

    def command(self, world: Path) -> list[str]:
        """The script and what is given to it."""
        return [self.script, *(word.replace("{world}", str(world)) for word in self.words)]

    def run(self, world: Path, *more: str, code: int = 0) -> str:
        """Run it in this process."""
        return run(*self.command(world), *more, code=code)


DATA = ("scenario=collision", "size=tiny", "data_dir={world}/data")
PICTURES = ("render=rgb", "render.resolution=16")
TRAINING = ("source.outputs={world}/outputs", "logger=[]", "trainer.enable_progress_bar=false")
DERENDERER = ("model.resolution=16", "model.width=2", "model.readout=linear", "num_images=200", "trainer.max_epochs=3")
TREE = ("source=cophy", "source.root={world}/tree", "trainer.max_epochs=1", "scenario=collision")
STEPS = (
    Step("generate", "generate", DATA),
    Step("render", "generate", (*DATA, *PICTURES)),
    Step("forecasts", "train", (*DATA, *TRAINING, "model=oracle_feedforward")),
    Step("derenderer", "train", (*DATA, *TRAINING, "model=derenderer", "render.resolution=16", *DERENDERER)),
    Step("derender", "derender", (*DATA, "outputs={world}/outputs", "workers=1")),
    Step("train", "train", (*DATA, *TRAINING, "trainer.max_epochs=5")),
    Step("estimated", "train", (*DATA, *TRAINING, "positions=derendered", "trainer.max_epochs=2", "model=in")),
    Step("report", "report", ("outputs={world}/outputs", "data_dir={world}/data")),
    Step("export", "export", (*DATA, "root={world}/tree", "render.resolution=16")),
    Step("look", "look", (*DATA, "render.resolution=32", "num_shown=1", "directory={world}/look")),
)


def make(world: Path) -> None:
    """Write the whole world."""
    for step in STEPS:
        step.run(world)


def contents(world: Path) -> dict[str, Any]:
    """What a world holds, by path: the same for the same commands, whatever happened on the way."""
    found: dict[str, Any] = {}
    for path in sorted(world.rglob("*")):
        name = str(path.relative_to(world))
        if path.name == "metrics.json":
            found[name] = {key: value for key, value in json.loads(path.read_bytes()).items() if key not in TIMES}
        elif path.suffix in SAME or path.name == "manifest.json":
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def copied(world: Path, to: Path) -> Path:
    """A copy of it, in the place of what is there."""
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(world, to)
    return to
