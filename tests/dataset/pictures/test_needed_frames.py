"""Only what is looked at is drawn, and it is drawn as always."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from cophy.dataset import generation
from cophy.dataset.estimates import Estimates
from cophy.dataset.experiment_set import ALL, FRAMES, INPUTS, TEST_INPUTS, ChosenFrames, NeededFrames
from cophy.dataset.frames import FrameDataModule
from cophy.dataset.images import Images
from cophy.dataset.splits import SPLITS
from tests.dataset.pictures.rendered import RENDER, copy_images, images
from tests.dataset.pictures.test_estimates import Guess

TEST = SPLITS.index("test")
CHOSEN = ChosenFrames.to_train(
    np.array([(0, 0, 3), (25, 1, 7), (25, 1, 8), (30, 0, 14), (0, 0, 3)]), "model=derenderer"
)


class Mean(Guess):
    """Tells pictures apart."""

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean = rgb.mean(axis=(1, 2, 3))
        return np.broadcast_to(mean[:, None, None], (len(rgb), 4, 3)), np.broadcast_to(mean[:, None], (len(rgb), 4))


def only(finished: Images, data_dir: Path, needed: NeededFrames) -> Images:
    """The same pictures, of some frames, of the same states; not drawn yet."""
    copied = copy_images(finished, data_dir)
    for path in copied.directory.iterdir():
        path.unlink()
    return copied.states.frames(RENDER, needed)


def test_what_models_see_is_ab_and_c() -> None:
    split = np.array([TEST, 0, 1, TEST])
    assert ALL.of(split, 0, 5).all()
    inputs, tested = INPUTS.of(split, 0, 5), TEST_INPUTS.of(split, 0, 5)
    assert inputs[:, 0].all()
    assert inputs[:, 1].sum(axis=1).tolist() == [1, 1, 1, 1]
    assert inputs[:, 1, 0].all()
    np.testing.assert_array_equal(tested[[0, 3]], inputs[[0, 3]])
    assert not tested[[1, 2]].any()
    assert list(FRAMES) == ["all", "inputs", "test_inputs"]


def test_chosen_frames_are_found_wherever_a_shard_begins() -> None:
    split = np.zeros(24, int)
    first, second = CHOSEN.of(split, 0, 15), CHOSEN.of(split, 24, 15)
    assert np.argwhere(first).tolist() == [[0, 0, 3]]
    assert np.argwhere(second).tolist() == [[1, 1, 7], [1, 1, 8], [6, 0, 14]]


def test_their_name_follows_from_what_they_are() -> None:
    frames = np.array(CHOSEN.frames)
    assert ChosenFrames.to_train(frames[::-1], "another=key").name == CHOSEN.name
    assert ChosenFrames.to_train(frames[1:], "").name != CHOSEN.name


@pytest.mark.parametrize("needed", [INPUTS, TEST_INPUTS, CHOSEN], ids=lambda needed: needed.name)
def test_some_frames_are_drawn_as_all_are(rendered: Images, tmp_path: Path, needed: NeededFrames) -> None:
    few = only(rendered, tmp_path, needed)
    generation.make(few, workers=2)
    arrays = few.states.load()
    drawn = needed.of(arrays["split"], 0, 15)
    read = few.load()
    assert few.directory.name.startswith(rendered.directory.name)
    np.testing.assert_array_equal(read["drawn"], drawn)
    for name, everything in rendered.load().items():
        np.testing.assert_array_equal(read[name][drawn], everything[drawn])
        assert (read[name][~drawn] == (-1 if name == "boxes" else 0)).all()
    if needed is not CHOSEN:
        return
    assert sum(few.path(shard).stat().st_size for shard in (0, 1)) < 0.25 * sum(
        rendered.path(shard).stat().st_size for shard in (0, 1)
    )


def test_a_frame_that_was_not_drawn_is_not_read(rendered: Images, tmp_path: Path) -> None:
    few = only(rendered, tmp_path, CHOSEN)
    generation.make(few, workers=1)
    read = few.reader(few.states.load())
    with h5py.File(rendered.path(1)) as file:
        np.testing.assert_array_equal(read(25, 1, 7), file["rgb"][1, 1, 7])
    with pytest.raises(ValueError, match="frame 9 of sequence 1 was not asked for"):
        read(25, 1, 9)


def test_frames_that_a_wider_set_holds_are_not_drawn_again(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    few = copied.states.frames(RENDER, TEST_INPUTS)
    few.ensure(workers=1)
    assert not few.directory.exists()
    assert few.or_more().directory == copied.directory
    arrays = copied.states.load()
    tested = set(np.flatnonzero(arrays["split"][24:] == TEST).tolist())
    seen = {(row, sequence): times.tolist() for row, sequence, times, _ in few.sequences(1)}
    assert seen == {(row, sequence): [[*range(15)], [0]][sequence] for row in tested for sequence in (0, 1)}


def test_a_narrower_set_is_no_substitute(rendered: Images, tmp_path: Path) -> None:
    few = only(rendered, tmp_path, TEST_INPUTS)
    generation.make(few, workers=1)
    for needed in (INPUTS, ALL, CHOSEN):
        wanted = few.states.frames(RENDER, needed)
        assert wanted.or_more() is not few
        assert not wanted.or_more().is_finished()


def test_estimates_of_some_frames_are_those_of_all(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    every, few = (Estimates(copied.states, Mean(), needed) for needed in (ALL, TEST_INPUTS))
    generation.make(few, workers=1)
    assert every.or_more().directory == every.directory
    generation.make(every, workers=1)
    needed = TEST_INPUTS.of(copied.states.load()["split"], 0, 15)
    for name, found in few.load().items():
        np.testing.assert_array_equal(found[needed], every.load()[name][needed])
        assert not found[~needed].any()
    for path in few.directory.iterdir():
        path.unlink()
    assert few.or_more().directory == every.directory


def test_a_derenderer_has_only_its_own_frames_drawn(rendered: Images, tmp_path: Path) -> None:
    states = only(rendered, tmp_path, ALL).states
    data = FrameDataModule([states], render=RENDER, resolution=16, num_images=40, data_seed=0, batch_size=8, workers=1)
    data.prepare_data()
    data.setup()
    pictures = data.train.sources[0][0]
    assert isinstance(pictures, Images)
    assert int(pictures.load()["drawn"].sum()) <= 48 + 15  # 40 to train, 4 to validate and to test; one whole sequence
    assert len(data.val.sequence_of(0).image) == 15
    with h5py.File(rendered.path(0)) as file:
        _, row, sequence, time = data.train.index[0].tolist()
        np.testing.assert_array_equal(data.train[0].image.numpy().transpose(1, 2, 0), file["rgb"][row, sequence, time])
    assert "model=derenderer num_images=40 data_seed=0 'num_objects=[2]'" in pictures.command


def test_where_half_of_the_frames_are_chosen_all_are_drawn(rendered: Images, tmp_path: Path) -> None:
    states = copy_images(rendered, tmp_path).states
    data = FrameDataModule(
        [states], render=RENDER, resolution=16, num_images=20_000, data_seed=0, batch_size=8, workers=1
    )
    data.prepare_data()
    data.setup()
    assert data.train.sources[0][0].directory == images(tmp_path).directory
