from pathlib import Path

import pytest

from tests.dataset.copies import SPEC


@pytest.fixture(scope="session")
def finished(tiny_data: Path) -> Path:
    """The directory of a finished dataset, not to be changed."""
    return SPEC.directory(tiny_data)
