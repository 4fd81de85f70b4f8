"""The index of a released dataset: lists of ids, broken experiments and clips."""

from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.estimates import Estimates
from cophy.dataset.frames import FrameDataset
from cophy.errors import CophyError
from cophy.oracles.forecasts import OracleForecasts, OracleSettings
from cophy.scenario.rendering import Backend, RenderSettings
from tests.released.indexing import LISTS, load, make, states
from tests.released.trees import BALL_COLORS, CoPhyTree, clip, filtered_tree

RENDER = RenderSettings(["rgb"], 16, Backend.tiny)


def test_an_index_is_written_once_and_again_when_experiments_are_added(towers: CoPhyTree) -> None:
    make(states("cophy", "blocktower", towers.root))
    (towers.root / "blocktowerCF/3/0/ab/states.npy").unlink()  # not read again
    assert states("cophy", "blocktower", towers.root).is_finished()
    assert len(states("cophy", "blocktower", towers.root).load()["split"]) == 4
    towers.tower("4")
    assert not states("cophy", "blocktower", towers.root).is_finished()


def test_only_the_same_lists_leave_test_experiments_unseen(towers: CoPhyTree) -> None:
    opened = states("cophy", "blocktower", towers.root)
    assert opened.has_same_splits(data_seed=0, trained_on=[opened.id])
    towers.lists("blocktowerCF", "_3_normal", train=["0", "3"], test=["1"])
    relisted = states("cophy", "blocktower", towers.root)
    assert relisted.directory == opened.directory
    assert not relisted.has_same_splits(data_seed=0, trained_on=[opened.id])


def test_a_folder_may_be_below_the_home(towers: CoPhyTree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(towers.root.parent))
    assert (
        states("cophy", "blocktower", Path("~", towers.root.name)).spec.ids
        == states("cophy", "blocktower", towers.root).spec.ids
    )


def test_oracles_refuse_released_data(towers: CoPhyTree) -> None:
    with pytest.raises(CophyError, match="released data lack what a simulation starts from"):
        OracleForecasts(
            states("cophy", "blocktower", towers.root),
            OracleSettings(draws=4, max_configurations=1, noise=0.1, max_experiments=2),
        )


@pytest.mark.parametrize("line", ["../../etc/passwd", "0/ab", "x" * 5 + "\x00"])
def test_an_id_that_is_a_path_is_refused_before_anything_is_written(towers: CoPhyTree, line: str) -> None:
    (towers.root / "splits/blocktowerCF_val_3_normal.txt").write_text(f"2\n{line}\n")
    with pytest.raises(CophyError, match=r"blocktowerCF_val_3_normal.txt, line 2: .* is not the id of an experiment"):
        states("cophy", "blocktower", towers.root)
    assert not towers.root.with_name("CoPhy_224-data").exists()


def test_lists_that_share_ids_or_are_missing_are_refused(towers: CoPhyTree) -> None:
    towers.lists("blocktowerCF", "_3_normal", test=["1", "3"])
    with pytest.raises(CophyError, match="share 1 ids, for example 1"):
        states("cophy", "blocktower", towers.root)
    (towers.root / "splits/blocktowerCF_test_3_normal.txt").unlink()
    with pytest.raises(CophyError, match=r"there is no blocktowerCF_test_3_normal.txt in .*source.splits="):
        states("cophy", "blocktower", towers.root)
    with pytest.raises(CophyError, match=r"no ballsCF_train_4.txt"):
        states("cophy", "balls", towers.root)


def test_one_wrong_gravity_makes_gravity_unknown_in_all(towers: CoPhyTree) -> None:
    (towers.root / "blocktowerCF/3/2/gravity.txt").write_text("gravity_x=1.0 gravity_y=0.5")
    arrays = load("cophy", "blocktower", towers.root)
    assert np.isnan(arrays["gravity"][:, :2]).all()
    assert not np.isnan(arrays["mass"]).any()


def test_empty_folders_are_skipped(towers: CoPhyTree, caplog: pytest.LogCaptureFixture) -> None:
    (towers.root / "blocktowerCF/3/17").mkdir()
    caplog.set_level("INFO")
    opened = make(states("cophy", "blocktower", towers.root))
    assert len(opened.load()["split"]) == 4
    assert "1 empty folders" in caplog.text
    assert not (opened.directory / "broken.txt").exists()


def test_if_all_experiments_are_broken_the_first_is_named(towers: CoPhyTree) -> None:
    for name in "0123":
        np.save(towers.root / f"blocktowerCF/3/{name}/confounders.npy", np.full((4, 2), 3.0))
    with pytest.raises(
        CophyError, match=r"4 of 4 experiments are broken, the first is 0: mass 3 .*scenario.confounders.mass"
    ):
        load("cophy", "blocktower", towers.root)


@pytest.mark.parametrize("source", ["cophy", "filtered_cophy"])
def test_frames_belong_to_their_states(tmp_path: Path, source: str) -> None:
    root = tmp_path / "root"
    if source == "cophy":
        tree = CoPhyTree(root)
        for name in "0123":
            tree.balls(name)
        tree.lists("ballsCF", "_4", **LISTS)
    else:
        filtered_tree(root, "ballsCF", list("0123"))
        for part, ids in LISTS.items():
            (root / f"ballsCF_4_{part}").write_text("\n".join(ids))
    missing = root / "ballsCF" / ("4/1" if source == "cophy" else "1") / "cd/rgb.mp4"
    missing.unlink()  # a missing clip is left out
    opened = states(source, "balls", root)
    make(opened)
    arrays = opened.load()
    frames = FrameDataset([(opened.frames(RENDER), arrays)], split="train", resolution=16)
    assert len(frames) == 3 * 30
    for item in (0, 3, 7, 12, 89):
        _, row, sequence, time = frames.index[item]
        seen = frames[item]
        assert abs(float(seen.image.float().mean()) - 8 * time) < 4
        np.testing.assert_array_equal(seen.position, arrays["states"][row, sequence, time, :, :3])
    assert set(frames.clusters.tolist()) == {0, 1}
    estimates = Estimates(opened, Brightness())
    estimates.directory.mkdir()
    estimates.write(estimates.path(0), 0, lambda count: None)
    estimates.write_manifest()
    position = estimates.load()["position"]
    np.testing.assert_allclose(position[2, 1, :, 0, 0], 8 * np.arange(30), atol=3.9)
    assert not position[1, 1].any()


def test_clips_of_different_sizes_are_named(tmp_path: Path) -> None:
    tree = CoPhyTree(tmp_path)
    for name in "0123":
        tree.balls(name)
    tree.lists("ballsCF", "_4", **LISTS)
    clip(tmp_path / "ballsCF/4/1/cd/rgb.mp4", 30, 5, 64)
    opened = states("cophy", "balls", tmp_path)
    make(opened)
    read = opened.frames(RENDER).pictures(opened.load(), ["rgb"])
    assert read(0)["rgb"].shape == (2, 30, 32, 32, 3)
    with pytest.raises(CophyError, match=r"ballsCF/4/1: the clips of ab and cd differ in size"):
        read(1)


class Brightness:
    """A de-renderer whose x is the brightness of the frame."""

    name, source = "brightness", Path("brightness.ckpt")
    render = RENDER

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position = np.zeros((len(rgb), len(BALL_COLORS), 3))
        position[..., 0] = rgb.mean(axis=(1, 2, 3))[:, None]
        return position, np.ones((len(rgb), len(BALL_COLORS)))
