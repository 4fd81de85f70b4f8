"""The world that is attacked, as each of its steps finds it."""

import os
from pathlib import Path

import pytest
from filelock import FileLock

from tests.attacks.world import STEPS, copied


@pytest.fixture(scope="session")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A world before each of STEPS, and the whole one: made once, shared by parallel test processes; copy them."""
    session = tmp_path_factory.getbasetemp()
    directory = (session.parent if "PYTEST_XDIST_WORKER" in os.environ else session) / "worlds"
    directory.mkdir(exist_ok=True)
    found = [directory / f"{number}" for number in range(len(STEPS) + 1)]
    with FileLock(directory / ".lock"):
        if not found[-1].exists():
            growing = directory / "growing"  # configurations of runs name their folder: it stays the same
            growing.mkdir()
            for step, before in zip(STEPS, found, strict=False):
                copied(growing, before)
                step.run(growing)
            copied(growing, found[-1])
    return found


@pytest.fixture(scope="session")
def attacks(request: pytest.FixtureRequest) -> int:
    """How often each is attacked."""
    return request.config.getoption("--attacks")
