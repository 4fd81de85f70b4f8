"""Shared fixtures: scenarios as configured, one simulator, tiny datasets made once per session."""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from filelock import FileLock

from cophy.config import settings
from cophy.dataset import generation
from cophy.dataset.features import confounder_features, to_batch
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.scenario import Scenario, Simulator
from cophy.schemas import register
from cophy.types import Batch

ROOT = Path(__file__).parents[1]
SCENARIOS = {"blocktower": 3, "balls": 4, "collision": 2}  # with the number of objects of its default split

register()
torch.set_num_threads(1)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--attacks", type=int, default=3, help="how often tests/attacks attack each thing (docs/trust.md)")


@pytest.fixture(scope="session")
def scenario_of() -> Callable[..., Scenario]:
    """A scenario as conf/ has it, with overrides."""
    return lambda name, *overrides: settings("generate", f"scenario={name}", *overrides).scenario


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    with Simulator() as simulator:
        yield simulator


@pytest.fixture(scope="session")
def tiny_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data directory with one tiny dataset per scenario, shared by parallel test processes."""
    session = tmp_path_factory.getbasetemp()
    directory = (session.parent if "PYTEST_XDIST_WORKER" in os.environ else session) / "tiny-data"
    directory.mkdir(exist_ok=True)
    with FileLock(directory / ".session.lock"):
        for name in SCENARIOS:
            generation.ensure(States(tiny_spec(name), directory), workers=2)
    return directory


def tiny_spec(name: str, num_objects: int | None = None, **size: Any) -> DatasetSpec:
    """The spec of a tiny dataset."""
    chosen = settings(
        "generate", f"scenario={name}", "size=tiny", *(f"size.{key}={value}" for key, value in size.items())
    )
    return DatasetSpec(chosen.scenario, num_objects or SCENARIOS[name], chosen.size, chosen.seed)


@pytest.fixture(scope="session", params=SCENARIOS)
def tiny(request: pytest.FixtureRequest, tiny_data: Path) -> tuple[DatasetSpec, dict[str, Any]]:
    """Each scenario's tiny dataset: its spec and its arrays."""
    spec = tiny_spec(request.param)
    return spec, States(spec, tiny_data).load()


@pytest.fixture(scope="session")
def tower_batch(tiny_data: Path) -> Batch:
    """All experiments of the tiny blocktower dataset, with true confounders, not standardised."""
    spec = tiny_spec("blocktower")
    arrays = States(spec, tiny_data).load()
    batch = to_batch(arrays, spec.scenario)
    return replace(batch, inputs=replace(batch.inputs, confounders=confounder_features(arrays)))
