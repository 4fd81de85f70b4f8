"""Frames of released clips."""

from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.estimates import Estimates
from cophy.dataset.frames import FrameDataset
from cophy.errors import CophyError
from cophy.scenario.rendering import Backend, RenderSettings
from tests.dataset.released.indexing import LISTS, make, states
from tests.dataset.released.trees import BALL_COLORS, CoPhyTree, clip, filtered_tree

RENDER = RenderSettings(["rgb"], 16, Backend.tiny)


@pytest.mark.parametrize("source", ["cophy", "filtered_cophy"])
def test_frames_are_those_of_their_states(tmp_path: Path, source: str) -> None:
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
    missing.unlink()  # a clip that is not there is not shown
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
    assert set(frames.pairs.tolist()) == {0, 1}
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
    """Sees how bright a frame is, and calls that x."""

    name, source = "brightness", Path("brightness.ckpt")
    render = RENDER

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position = np.zeros((len(rgb), len(BALL_COLORS), 3))
        position[..., 0] = rgb.mean(axis=(1, 2, 3))[:, None]
        return position, np.ones((len(rgb), len(BALL_COLORS)))
