"""Shared fixtures: scenarios as configured, one simulator, and tiny data and trained runs made once per session."""

import copy
import functools
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import torch

from cophy.config import FOLDERS, settings
from cophy.dataset import generation
from cophy.dataset.features import confounder_features, to_batch
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States, sort_by_twins
from cophy.errors import CophyError
from cophy.locks import locked
from cophy.scenario import Scenario, Simulator, rendering
from cophy.schemas import register
from cophy.types import Batch

ROOT = Path(__file__).parents[1]
FLOOR_PX = rendering.FLOOR_PX
SCENARIOS = {"blocktower": 3, "balls": 4, "collision": 2}  # with the number of objects of its default split

for variable in FOLDERS:
    os.environ.pop(variable, None)
register(models=True)
torch.set_num_threads(1)


def quick_first(values: Iterable[Any], count: int = 1) -> list[Any]:
    """Return parameters of a test of which only the first few run in the quick suite."""
    return [
        pytest.param(value, marks=[] if number < count else [pytest.mark.slow]) for number, value in enumerate(values)
    ]


@contextmanager
def refused(message: str) -> Iterator[pytest.ExceptionInfo[CophyError]]:
    """Expect an error whose message has one line and contains this text."""
    with pytest.raises(CophyError) as error:
        yield error
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@functools.cache
def cached_settings(command: str, *overrides: str) -> Any:
    """Return what `cophy.config.settings` returns, composed once per process (a composition takes 0.3 s); do not change it."""
    return settings(command, *overrides)


@pytest.fixture(scope="session")
def scenario_of() -> Callable[..., Scenario]:
    """A scenario as conf/ has it, with overrides."""
    return lambda name, *overrides: copy.deepcopy(cached_settings("generate", f"scenario={name}", *overrides).scenario)


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    with Simulator() as simulator:
        yield simulator


def once_per_session(tmp_path_factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a directory that `make` fills once, for all parallel test processes. Tests only read it."""
    session = tmp_path_factory.getbasetemp()
    directory = (session.parent if "PYTEST_XDIST_WORKER" in os.environ else session) / name
    directory.mkdir(exist_ok=True)
    with locked(directory / ".session.lock", elsewhere="--basetemp"):
        if not (directory / ".complete").exists():
            make(directory)
            (directory / ".complete").touch()
    return directory


def raising(number: int) -> Callable[..., Any]:
    """Return a function that raises the OSError of this number."""

    def raise_error(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    return raise_error


class RunsCode:
    """Creates a folder when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


class ThisProcess:
    """An executor that runs everything at once in this process."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future


@contextmanager
def pool_in_this_process(workers: int, initializer: Callable[..., None], *arguments: Any) -> Iterator[ThisProcess]:
    initializer(*arguments)
    yield ThisProcess()


@pytest.fixture(scope="session", autouse=True)
def generation_in_this_process() -> Iterator[None]:
    """Generate data without worker processes, whose imports take seconds; commands in processes of their own have them."""
    with mock.patch.object(generation, "worker_pool", pool_in_this_process):
        yield


def floors_of(pixels: int) -> AbstractContextManager[None]:
    """Draw textures of floors with this many rows and columns; a context manager, or a decorator of a test."""
    return mock.patch.object(rendering, "FLOOR_PX", pixels)


@pytest.fixture(scope="session", autouse=True)
def small_floors() -> Iterator[None]:
    """Draw small floors, because those of full size take longer than all the rest of a small image.

    Commands in processes of their own draw the full size, so their images are not compared with those of this process.
    """
    with floors_of(512):
        yield


@pytest.fixture(scope="session")
def tiny_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data directory with one tiny dataset per scenario."""

    def generate(directory: Path) -> None:
        for name in SCENARIOS:
            generation.ensure(States(tiny_spec(name), directory), workers=1)

    return once_per_session(tmp_path_factory, "tiny-data", generate)


def tiny_spec(name: str, num_objects: int | None = None, **size: Any) -> DatasetSpec:
    """The spec of a tiny dataset."""
    overrides = (f"size.{key}={value}" for key, value in size.items())
    config = copy.deepcopy(cached_settings("generate", f"scenario={name}", "size=tiny", *overrides))
    return DatasetSpec(config.scenario, num_objects or SCENARIOS[name], config.size, config.seed)


@pytest.fixture(scope="session", params=SCENARIOS)
def tiny(request: pytest.FixtureRequest, tiny_data: Path) -> tuple[DatasetSpec, dict[str, Any]]:
    """Each scenario's tiny dataset: its spec and its arrays, twins next to each other."""
    spec = tiny_spec(request.param)
    return spec, sort_by_twins(States(spec, tiny_data).load(), spec)


@pytest.fixture(scope="session")
def tower_batch(tiny_data: Path) -> Batch:
    """All experiments of the tiny blocktower dataset, with true confounders, not standardised."""
    spec = tiny_spec("blocktower")
    arrays = sort_by_twins(States(spec, tiny_data).load(), spec)
    batch = to_batch(arrays, spec.scenario)
    return replace(batch, inputs=replace(batch.inputs, confounders=confounder_features(arrays)))
