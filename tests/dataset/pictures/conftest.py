import pytest

from cophy.dataset.images import Images
from tests.dataset.pictures.rendered import images


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Images:
    """A finished dataset with its pictures, not to be changed."""
    drawn = images(tmp_path_factory.mktemp("images"))
    drawn.ensure(workers=2)
    return drawn
