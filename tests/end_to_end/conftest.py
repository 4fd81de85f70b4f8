"""One trained run for all tests that only need a finished one."""

import shutil
from pathlib import Path

import pytest

from tests.commands import train
from tests.conftest import once_per_session


@pytest.fixture(scope="session")
def outputs(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of runs with one finished run: CoPhyNet on collisions, one epoch. Tests only read it."""

    def train_once(directory: Path) -> None:
        train("scenario=collision", "logger=tensorboard", f"source.outputs={directory}", data=tiny_data)

    return once_per_session(tmp_path_factory, "outputs", train_once)


@pytest.fixture(scope="session")
def trained_run(outputs: Path) -> Path:
    """The directory of the finished run. Tests only read it."""
    return next(outputs.rglob("metrics.json")).parent


@pytest.fixture
def copied_run(trained_run: Path, tmp_path: Path) -> Path:
    """A copy of the finished run, which a test may change."""
    return Path(shutil.copytree(trained_run, tmp_path / "copied"))
