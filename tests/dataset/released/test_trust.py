"""What is broken, empty or doubtful is said, and not believed."""

import numpy as np
import pytest

from cophy.errors import CophyError
from tests.dataset.released.indexing import load, make, states
from tests.dataset.released.trees import CoPhyTree


def test_one_gravity_that_is_none_discredits_all(towers: CoPhyTree) -> None:
    (towers.root / "blocktowerCF/3/2/gravity.txt").write_text("gravity_x=1.0 gravity_y=0.5")
    arrays = load("cophy", "blocktower", towers.root)
    assert np.isnan(arrays["gravity"][:, :2]).all()
    assert not np.isnan(arrays["mass"]).any()


def test_empty_folders_are_passed_over(towers: CoPhyTree, caplog: pytest.LogCaptureFixture) -> None:
    (towers.root / "blocktowerCF/3/17").mkdir()
    caplog.set_level("INFO")
    opened = make(states("cophy", "blocktower", towers.root))
    assert len(opened.load()["split"]) == 4
    assert "1 empty folders" in caplog.text
    assert not (opened.directory / "broken.txt").exists()


def test_when_all_are_broken_the_first_is_named(towers: CoPhyTree) -> None:
    for name in "0123":
        np.save(towers.root / f"blocktowerCF/3/{name}/confounders.npy", np.full((4, 2), 3.0))
    with pytest.raises(
        CophyError, match=r"4 of 4 experiments are broken, the first is 0: mass 3 .*scenario.confounders.mass"
    ):
        load("cophy", "blocktower", towers.root)
