from pathlib import Path

import pytest

from tests.released.indexing import LISTS
from tests.released.trees import CoPhyTree


@pytest.fixture
def tree(tmp_path: Path) -> CoPhyTree:
    return CoPhyTree(tmp_path / "CoPhy_224")


@pytest.fixture
def towers(tree: CoPhyTree) -> CoPhyTree:
    """Four towers of three, ids 0 to 3, one per list but for training."""
    for name in "0123":
        tree.tower(name)
    tree.lists("blocktowerCF", "_3_normal", **LISTS)
    return tree
