"""A small world of what the commands write: data, images, estimates, runs, a report and an exported tree."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from signal import SIGKILL
from typing import Any

import pytest

from tests.commands import run, without_times
from tests.conftest import ROOT, once_per_session

EXACT = {".h5", ".csv", ".npz", ".npy", ".mp4", ".txt", ".tex"}  # files that have the same bytes every time


@dataclass(frozen=True)
class Step:
    """A command; {world} in its words stands for the folder of the world."""

    name: str
    script: str
    words: tuple[str, ...]

    def command(self, world: Path) -> list[str]:
        return [self.script, *(word.replace("{world}", str(world)) for word in self.words)]

    @contextmanager
    def started(self, world: Path, log: Path) -> Iterator["subprocess.Popen[bytes]"]:
        """Run the command in processes of its own, of which none is left at the end; they print to `log`."""
        script, *words = self.command(world)
        command = [sys.executable, str(ROOT / "src" / f"{script}.py"), *words]
        with open(log, "w") as file:
            process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):  # all processes have ended
                os.killpg(process.pid, SIGKILL)
            process.wait()

    def finish(self, world: Path, log: Path) -> None:
        """Run the command to its end without an error."""
        with self.started(world, log) as process:
            code = process.wait(timeout=600)
        assert code == 0, log.read_text()[-3000:]
        assert "Traceback" not in log.read_text()


DATA = ("scenario=collision", "size=tiny", "data_dir={world}/data")
TRAINING = ("source.outputs={world}/outputs", "logger=[]", "trainer.enable_progress_bar=false")
DERENDERER = (
    "model=derenderer",
    "render.resolution=16",
    "model.resolution=16",
    "model.width=2",
    "model.readout=linear",
)
ESTIMATED = ("positions=derendered", "model=in", "trainer.max_epochs=2")
STEPS = (
    Step("generate", "generate", DATA),
    Step("render", "generate", (*DATA, "render=all", "render.modalities=[rgb,segmentation]", "render.resolution=16")),
    Step("oracles", "train", (*DATA, *TRAINING, "model=oracle_feedforward")),
    Step("derenderer", "train", (*DATA, *TRAINING, *DERENDERER, "num_images=200", "trainer.max_epochs=3")),
    Step("derender", "derender", (*DATA, "outputs={world}/outputs", "workers=1")),
    Step("train", "train", (*DATA, *TRAINING, "trainer.max_epochs=5")),
    Step("estimated", "train", (*DATA, *TRAINING, *ESTIMATED)),
    Step("report", "report", ("outputs={world}/outputs", "data_dir={world}/data")),
    Step("export", "export", (*DATA, "root={world}/tree", "render.resolution=16")),
)


@pytest.fixture(scope="session")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The world before each step, and after the last; parallel test processes share these folders, so copy them."""

    def make(directory: Path) -> None:
        world = directory / "world"  # configurations of runs name their folder, so it stays the same
        world.mkdir()
        for number, step in enumerate(STEPS):
            copy_world(world, directory / f"{number}")
            run(*step.command(world))
        copy_world(world, directory / f"{len(STEPS)}")

    directory = once_per_session(tmp_path_factory, "worlds", make)
    return [directory / f"{number}" for number in range(len(STEPS) + 1)]


def copy_world(world: Path, target: Path) -> Path:
    """Copy a world over another one and return the copy."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(world, target)
    return target


def contents(world: Path) -> dict[str, Any]:
    """Return, by path, everything that is the same after the same commands, whatever interrupted them."""
    result: dict[str, Any] = {}
    for path in sorted(world.rglob("*")):
        name = str(path.relative_to(world))
        if path.name == "metrics.json":
            result[name] = without_times(json.loads(path.read_bytes()))
        elif path.suffix in EXACT or path.name == "manifest.json":
            result[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return result
