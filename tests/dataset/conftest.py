from pathlib import Path

import pytest

from cophy.dataset.images import Images
from tests.conftest import once_per_session
from tests.dataset.copies import SPEC, images


@pytest.fixture(scope="session")
def finished(tiny_data: Path) -> Path:
    """The directory of a finished dataset; tests only read it."""
    return SPEC.directory(tiny_data)


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Images:
    """A finished dataset with its images; tests only read it."""
    return images(once_per_session(tmp_path_factory, "images", lambda path: images(path).ensure(workers=1)))


@pytest.fixture(scope="session")
def few(rendered: Images) -> Path:
    """The directory of the states of `rendered`, which are generated again quickly; tests only read it."""
    return rendered.states.directory
