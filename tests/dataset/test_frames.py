"""Frames for the de-renderer."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from cophy.dataset.frames import FrameDataModule, FrameDataset
from cophy.dataset.images import Images
from cophy.dataset.states import States
from cophy.errors import CophyError
from tests.dataset.copies import RENDER, copy_images, empty, images


def frames_of(states: States, num_images: int) -> FrameDataModule:
    data = FrameDataModule(
        [states], render=RENDER, resolution=16, num_images=num_images, data_seed=0, batch_size=10, workers=1
    )
    data.prepare_data()
    data.setup()
    return data


def test_frames_are_those_of_their_split(rendered: Images, tmp_path: Path) -> None:
    data = frames_of(copy_images(rendered, tmp_path).states, 100)
    assert (len(data.train), len(data.val), len(data.test)) == (100, 10, 10)
    arrays = data.train.sources[0][1]
    for frames, split in ((data.train, 0), (data.val, 1), (data.test, 2)):
        assert set(arrays["split"][frames.index[:, 1]]) == {split}
    batch = next(iter(data.train_dataloader()))
    assert batch.image.shape == (10, 3, 16, 16)
    assert batch.presence.sum(dim=1).tolist() == [2] * 10
    loader = data.train_dataloader()
    opened, order = iter(loader), loader.sampler
    order.set_epoch(3)  # as Lightning does when a training resumes: only after it opened the loader
    wanted = [data.train[item].position for item in list(order)[:10]]
    np.testing.assert_array_equal(next(opened).position, np.stack(wanted))
    item = data.train[3]
    _, row, sequence, frame = data.train.index[3].tolist()
    np.testing.assert_array_equal(item.position, arrays["states"][row, sequence, frame, :, :3])


def test_a_damaged_image_is_named_in_one_line(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    data = frames_of(copied.states, 100)
    for shard in copied.paths():
        shard.write_bytes(b"damaged")
    with pytest.raises(CophyError, match=r"^\S+\.h5 is damaged .* to generate it again$") as raised:
        list(data.train_dataloader())
    assert "\n" not in str(raised.value)


def test_images_of_other_states_are_not_read(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    with h5py.File(copied.path(0), "r+") as file:
        file.attrs["states_sha256"] = "0" * 64
    frames = FrameDataset([(copied, copied.states.load())], split="train", resolution=16)
    with pytest.raises(CophyError, match=r"shard-00000\.h5 is damaged \(it belongs to other data: its states_sha256"):
        frames[0]


def test_only_the_frames_of_a_derenderer_are_rendered(rendered: Images, tmp_path: Path) -> None:
    copied = copy_images(rendered, tmp_path)
    empty(copied.directory)
    data = frames_of(copied.states, 40)
    source = data.train.sources[0][0]
    assert isinstance(source, Images)
    assert int(source.load()["drawn"].sum()) <= 48 + 15  # 40 to train, 4 to validate and to test; one whole sequence
    assert len(data.val.sequence_of(0).image) == 15
    with h5py.File(rendered.path(0)) as file:
        _, row, sequence, time = data.train.index[0].tolist()
        np.testing.assert_array_equal(data.train[0].image.numpy().transpose(1, 2, 0), file["rgb"][row, sequence, time])
    assert "model=derenderer num_images=40 data_seed=0 'num_objects=[2]'" in source.command


def test_all_frames_are_rendered_if_half_of_them_are_chosen(rendered: Images, tmp_path: Path) -> None:
    data = frames_of(copy_images(rendered, tmp_path).states, 20_000)
    assert data.train.sources[0][0].directory == images(tmp_path).directory


def test_a_split_without_frames_is_refused_before_training(rendered: Images, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FrameDataset, "sample", lambda frames, count, seed: frames._with(frames.index[: count - 10]))
    with pytest.raises(CophyError, match=r"there are no \w+ frames: use a larger size="):
        frames_of(rendered.states, 100)
