"""The index of a released dataset."""

import pytest

from cophy.dataset import generation
from cophy.dataset.experiment_set import OracleSettings
from cophy.errors import CophyError
from tests.dataset.released.indexing import states
from tests.dataset.released.trees import CoPhyTree


def test_an_index_is_made_once_and_again_when_experiments_come(towers: CoPhyTree) -> None:
    opened = states("cophy", "blocktower", towers.root)
    generation.make(opened, workers=1)
    (towers.root / "blocktowerCF/3/0/ab/states.npy").unlink()  # read no more
    assert states("cophy", "blocktower", towers.root).is_finished()
    assert len(states("cophy", "blocktower", towers.root).load()["split"]) == 4
    towers.tower("4")
    assert not states("cophy", "blocktower", towers.root).is_finished()


def test_only_the_same_lists_leave_test_experiments_unseen(towers: CoPhyTree) -> None:
    opened = states("cophy", "blocktower", towers.root)
    assert opened.unseen_by(num_experiments={}, data_seed=0, trained_on=[opened.id])
    towers.lists("blocktowerCF", "_3_normal", train=["0", "3"], test=["1"])
    relisted = states("cophy", "blocktower", towers.root)
    assert relisted.directory == opened.directory
    assert not relisted.unseen_by(num_experiments={}, data_seed=0, trained_on=[opened.id])


def test_no_oracle_simulates_released_data(towers: CoPhyTree) -> None:
    with pytest.raises(CophyError, match="released data lack what a simulation starts from"):
        states("cophy", "blocktower", towers.root).forecasts(
            OracleSettings(draws=4, max_configurations=1, noise=0.1, max_experiments=2)
        )
