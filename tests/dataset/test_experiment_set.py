"""Choices of frames."""

import numpy as np

from cophy.dataset.experiment_set import ALL_FRAMES, FRAMES, INPUTS, TEST_INPUTS, single_frames
from cophy.dataset.splits import SPLITS

TEST = SPLITS.index("test")
SINGLE = single_frames(np.array([(0, 0, 3), (7, 1, 7), (7, 1, 8), (9, 0, 14), (0, 0, 3)]), "model=derenderer")


def test_models_need_ab_and_c() -> None:
    split = np.array([TEST, 0, 1, TEST])
    assert ALL_FRAMES.mask(split, 0, 5).all()
    inputs, tested = INPUTS.mask(split, 0, 5), TEST_INPUTS.mask(split, 0, 5)
    assert inputs[:, 0].all()
    assert inputs[:, 1].sum(axis=1).tolist() == [1, 1, 1, 1]
    assert inputs[:, 1, 0].all()
    np.testing.assert_array_equal(tested[[0, 3]], inputs[[0, 3]])
    assert not tested[[1, 2]].any()
    assert list(FRAMES) == ["all", "inputs", "test", "test_inputs"]


def test_single_frames_are_needed_wherever_a_shard_begins() -> None:
    split = np.zeros(6, int)
    assert np.argwhere(SINGLE.mask(split, 0, 15)).tolist() == [[0, 0, 3]]
    assert np.argwhere(SINGLE.mask(split, 6, 15)).tolist() == [[1, 1, 7], [1, 1, 8], [3, 0, 14]]
    assert not single_frames(np.zeros((0, 3), int), "").mask(split, 0, 15).any()


def test_the_name_of_single_frames_depends_only_on_them() -> None:
    frames = np.array(SINGLE.single)
    assert single_frames(frames[::-1], "another=key").name == SINGLE.name
    assert single_frames(frames[1:], "").name != SINGLE.name
