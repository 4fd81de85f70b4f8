"""Frames for the de-renderer."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.frames import FrameDataModule
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario.rendering import Backend, RenderSettings
from tests.conftest import tiny_spec


def frames_of(tiny_data: Path) -> FrameDataModule:
    data = FrameDataModule(
        [States(tiny_spec("collision"), tiny_data)],
        render=RenderSettings(["rgb"], 16, Backend.tiny),
        resolution=16,
        num_images=100,
        data_seed=0,
        batch_size=10,
        workers=2,
    )
    data.prepare_data()
    data.setup()
    return data


def test_frames_are_those_of_the_split_they_are_asked_for(tiny_data: Path) -> None:
    data = frames_of(tiny_data)
    assert (len(data.train), len(data.val), len(data.test)) == (100, 10, 10)
    arrays = data.train.sources[0][1]
    for frames, split in ((data.train, 0), (data.val, 1), (data.test, 2)):
        assert set(arrays["split"][frames.index[:, 1]]) == {split}
    batch = next(iter(data.train_dataloader()))
    assert batch.image.shape == (10, 3, 16, 16)
    assert batch.presence.sum(dim=1).tolist() == [2] * 10
    loader = data.train_dataloader()
    opened, order = iter(loader), loader.sampler
    order.set_epoch(3)  # as Lightning does where a training goes on: only after it opened the loader
    wanted = [data.train[item].position for item in list(order)[:10]]
    np.testing.assert_array_equal(next(opened).position, np.stack(wanted))
    item = data.train[3]
    _, row, sequence, frame = data.train.index[3].tolist()
    np.testing.assert_array_equal(item.position, arrays["states"][row, sequence, 4 * frame, :, :3])


def test_a_damaged_picture_is_named_in_one_line(tiny_data: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(tiny_data, tmp_path / "data")
    data = frames_of(copy)
    for kind in ("rgb", "images"):  # another test may have drawn more, which are read instead
        for shard in copy.rglob(f"{kind}-*/shard-*.h5"):
            shard.write_bytes(b"no longer")
    with pytest.raises(CophyError, match=r"^\S+\.h5 is damaged .* to make it again$") as raised:
        list(data.train_dataloader())
    assert "\n" not in str(raised.value)
