from pathlib import Path
from typing import Any

import pytest

from cophy.dataset.spec import DatasetSpec
from cophy.dataset.store.states import States
from tests.conftest import tiny_spec


@pytest.fixture
def tiny_collision(tiny_data: Path) -> tuple[DatasetSpec, dict[str, Any]]:
    """The tiny dataset whose oracles are cheapest."""
    spec = tiny_spec("collision")
    return spec, States(spec, tiny_data).load()
