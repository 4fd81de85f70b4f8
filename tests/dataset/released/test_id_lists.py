"""Lists of ids lead nowhere else, and split without overlap."""

import pytest

from cophy.errors import CophyError
from tests.dataset.released.indexing import states
from tests.dataset.released.trees import CoPhyTree


@pytest.mark.parametrize("line", ["../../etc/passwd", "/etc/passwd", "..", "0/ab", "a b", "x" * 5 + "\x00"])
def test_a_list_that_leads_elsewhere_is_refused_before_anything_is_written(towers: CoPhyTree, line: str) -> None:
    (towers.root / "splits/blocktowerCF_val_3_normal.txt").write_text(f"2\n{line}\n")
    with pytest.raises(CophyError, match=r"blocktowerCF_val_3_normal.txt, line 2: .* is not the id of an experiment"):
        states("cophy", "blocktower", towers.root)
    assert not towers.root.with_name("CoPhy_224-data").exists()


def test_lists_that_share_ids_or_are_missing_are_refused(towers: CoPhyTree) -> None:
    towers.lists("blocktowerCF", "_3_normal", test=["1", "3"])
    with pytest.raises(CophyError, match="share 1 ids, 1 for one"):
        states("cophy", "blocktower", towers.root)
    (towers.root / "splits/blocktowerCF_test_3_normal.txt").unlink()
    with pytest.raises(CophyError, match=r"there is no blocktowerCF_test_3_normal.txt in .*source.splits="):
        states("cophy", "blocktower", towers.root)
    with pytest.raises(CophyError, match=r"no ballsCF_train_4.txt"):
        states("cophy", "balls", towers.root)
