"""The wheel in a new environment of each Python on this machine: the steps of a user, with data of this environment.

`just test-pythons` runs them and prints the time of each; `-k 3.13` selects a version and `-k without_torch` the steps that
download neither torch nor Lightning. Environments are in .venvs, one at a time; torch's CUDA build, which pip takes on Linux
unless PIP_EXTRA_INDEX_URL or PIP_FIND_LINKS offers another, needs 6 GB.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.pythons.interpreters import VERSIONS, find

pytestmark = pytest.mark.pythons
TORCH = "torch==2.13.0"  # as in the justfile
HAVE_PYBULLET = ("3.10", "3.11")  # versions with wheels of it

SCORE_OF_ARRAYS = """
import sys
import numpy as np
import cophy
from cophy.scoring import Predictions, Truth

arrays = {
    "experiment": np.arange(2),
    "position": np.full((2, 3, 1, 3), 2.0),
    "stable_logit": np.ones((2, 3, 1)),
}
truth = Truth(
    experiment=np.arange(2), position=np.zeros((2, 3, 1, 3)), stable=np.ones((2, 3, 1), bool),
    presence=np.ones((2, 1), bool), initial=np.zeros((2, 1, 3)), pair=np.zeros(2, int), cluster=np.zeros(2, int),
    cell=np.zeros(2, int), metric_dims=3,
)
assert cophy.score(Predictions.from_arrays(arrays), truth).means()["mse"] == 4.0
assert issubclass(cophy.CophyError, Exception)
assert not {"torch", "lightning", "hydra"} & sys.modules.keys()
"""

SCORE_OF_RUN = """
import json, sys
import numpy as np
import cophy
from cophy.scoring import Predictions, Truth

arrays = np.load(f"{sys.argv[1]}/predictions.npz")
scores = cophy.score(Predictions.from_arrays(arrays), Truth.from_arrays(arrays, metric_dims=3))
mse = json.load(open(f"{sys.argv[1]}/metrics.json"))["metrics"]["mse"]
assert scores.means()["mse"] == mse, (scores.means()["mse"], mse)
"""


def execute(*command: object, folder: Path, code: int = 0) -> str:
    """Run a program in a folder, without this checkout's packages, and return what it prints."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, f"{words}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout + done.stderr


class Environment:
    """A new environment of one Python, and an empty folder to work in.

    Attributes:
        version: The version of Python, such as 3.10.
        python: Path of the interpreter.
        folder: The folder to work in.
    """

    def __init__(self, version: str, root: Path, folder: Path) -> None:
        interpreter = find(version)
        if interpreter is None:
            pytest.skip(f"no Python {version} on PATH or in pyenv")
        self.version, self.folder, self.python = version, folder, root / "bin" / "python"
        shutil.rmtree(root, ignore_errors=True)
        execute(interpreter, "-m", "venv", root, folder=folder)

    def install(self, *packages: object) -> None:
        """Install packages with pip."""
        execute(self.python, "-m", "pip", "install", "--no-compile", *packages, folder=self.folder)

    def run(self, *words: object, code: int = 0) -> str:
        """Run Python and return what it prints."""
        return execute(self.python, *words, folder=self.folder, code=code)

    def command(self, name: str, *words: object, code: int = 0) -> str:
        """Run a command of the package and return what it prints."""
        return execute(self.python.with_name(f"cophy-{name}"), *words, folder=self.folder, code=code)


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    execute(sys.executable, "-m", "pip", "wheel", "--no-deps", "-w", folder, ROOT, folder=folder)
    (path,) = folder.glob("cophy-*.whl")
    return path


def environments(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Environment]:
    root = ROOT / ".venvs" / request.param
    yield Environment(request.param, root, tmp_path_factory.mktemp("work"))
    shutil.rmtree(root)


@pytest.fixture(scope="module", params=VERSIONS)
def small(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, wheel: Path
) -> Iterator[Environment]:
    """An environment with the wheel, NumPy and SciPy."""
    for environment in environments(request, tmp_path_factory):
        environment.install("numpy>=1.26", "scipy>=1.15")
        environment.install("--no-deps", wheel)
        yield environment


@pytest.fixture(scope="module", params=VERSIONS)
def full(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, wheel: Path
) -> Iterator[Environment]:
    """An environment with the wheel and all that it requires."""
    for environment in environments(request, tmp_path_factory):
        environment.install(TORCH, wheel)
        yield environment


def test_scores_without_torch(small: Environment) -> None:
    small.run("-c", SCORE_OF_ARRAYS)


def test_the_commands_are_listed_without_torch(small: Environment) -> None:
    assert "cophy-train " in small.run("-m", "cophy")


def test_install(full: Environment) -> None:
    full.run("-m", "pip", "check")
    assert "site-packages" in full.run("-c", "import cophy; print(cophy.__file__)")


def test_load(full: Environment, tiny_data: Path) -> None:
    code = "import sys, cophy; print(len(cophy.load('collision', size='tiny', data_dir=sys.argv[1])))"
    assert int(full.run("-c", code, tiny_data).split()[-1]) > 0


def test_train(full: Environment, tiny_data: Path) -> None:
    """The default training, with its loggers, which have died on some Pythons."""
    words = ("scenario=collision", "model=cophynet", "size=tiny", f"data_dir={tiny_data}", "trainer.max_epochs=2")
    full.command("train", *words)
    assert len(list(full.folder.glob("outputs/**/metrics.json"))) == 1


def test_score(full: Environment) -> None:
    (metrics,) = full.folder.glob("outputs/**/metrics.json")
    full.run("-c", SCORE_OF_RUN, metrics.parent)


def test_report(full: Environment) -> None:
    full.command("report")
    assert "CoPhyNet" in (full.folder / "outputs/report/tables.md").read_text()


def test_generate(full: Environment) -> None:
    words = ("scenario=collision", "size=tiny", "workers=1")
    if full.version in HAVE_PYBULLET:
        full.command("generate", *words)
        assert list((full.folder / "data").rglob("*.h5"))
    else:
        assert "need PyBullet" in full.command("generate", *words, code=1).splitlines()[-1]
