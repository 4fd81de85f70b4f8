"""Pictures on disk: lossless, resumable, and of the states beside them."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from cophy.dataset import generation
from cophy.dataset.estimates import Estimates
from cophy.dataset.frames import FrameDataModule, FrameDataset
from cophy.dataset.images import Images
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario.rendering import MODALITIES, Backend, Renderer, RenderSettings
from cophy.training.pictures import render_sequence
from tests.conftest import ROOT, settings, tiny_spec

RENDER = RenderSettings(list(MODALITIES), 16, Backend.tiny)
SPEC = tiny_spec("collision")


def images(data_dir: Path) -> Images:
    return Images(States(SPEC, data_dir), RENDER)


def digests(directory: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in directory.glob("*.[hj]*")}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Images:
    rendered = images(tmp_path_factory.mktemp("images"))
    for shards in (rendered.states, rendered):
        generation.make(shards, workers=2)
    return rendered


def copy(finished: Images, data_dir: Path) -> Images:
    copied = images(data_dir)
    copied.directory.mkdir(parents=True)
    for source, target in (
        (finished.states.directory, copied.states.directory),
        (finished.directory, copied.directory),
    ):
        for path in source.glob("*.[hj]*"):
            (target / path.name).write_bytes(path.read_bytes())
    return copied


def test_what_is_stored_is_what_was_drawn(finished: Images) -> None:
    arrays = finished.states.load()
    with Renderer(SPEC.scenario, RENDER.resolution) as renderer, h5py.File(finished.path(1), "r") as file:
        for experiment, sequence in ((20, 0), (27, 1)):
            drawn = render_sequence(renderer, arrays, experiment, sequence, slice(None))
            for name in MODALITIES:
                np.testing.assert_array_equal(file[name][experiment - 20, sequence], getattr(drawn, name))


def start_rendering(data_dir: Path) -> "subprocess.Popen[bytes]":
    command = [sys.executable, str(ROOT / "src" / "generate.py"), "scenario=collision", "size=tiny", "workers=2"]
    command += [f"data_dir={data_dir}", "render=all", f"render.resolution={RENDER.resolution}"]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


def empty(copied: Images) -> None:
    for path in copied.directory.iterdir():
        path.unlink()


def test_a_killed_rendering_continues_to_the_same_bytes(finished: Images, tmp_path: Path) -> None:
    copied = copy(finished, tmp_path)
    empty(copied)
    process = start_rendering(tmp_path)
    while not any(copied.path(shard).exists() for shard in range(SPEC.num_shards)):
        assert process.poll() is None, "rendering ended before it could be killed"
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    generation.make(copied, workers=2)
    assert digests(copied.directory) == digests(finished.directory)


@pytest.mark.slow
def test_ten_kills_at_random_moments_change_no_byte(finished: Images, tmp_path: Path) -> None:
    copied, rng = copy(finished, tmp_path), np.random.default_rng(0)
    empty(copied)
    for _ in range(10):
        process = start_rendering(tmp_path)
        time.sleep(rng.uniform(0.5, 6.0))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        for shard in range(SPEC.num_shards):
            if copied.path(shard).exists() and rng.random() < 0.5:
                copied.path(shard).unlink()  # so that there is always something left to do
    generation.make(copied, workers=2)
    assert digests(copied.directory) == digests(finished.directory)
    assert not list(copied.directory.glob("*.tmp"))


def test_a_damaged_shard_is_named_and_only_it_is_drawn_again(
    finished: Images, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copied = copy(finished, tmp_path)
    path, untouched = copied.path(1), copied.path(0).stat().st_mtime_ns
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    generation.make(copied, workers=1)
    assert "shard-00001.h5 is damaged (its checksum" in caplog.text
    assert "shard-00000.h5 is damaged" not in caplog.text
    assert copied.path(0).stat().st_mtime_ns == untouched
    assert digests(copied.directory) == digests(finished.directory)


def test_a_pixel_that_was_changed_is_not_read(finished: Images, tmp_path: Path) -> None:
    copied = copy(finished, tmp_path)
    with h5py.File(copied.path(0), "r") as file:
        chunk = file["rgb"].id.get_chunk_info(0)
    content = bytearray(copied.path(0).read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 255
    copied.path(0).write_bytes(content)
    with (
        pytest.raises(CophyError, match=r"shard-00000\.h5 is damaged .* render=all .* render\.resolution=16"),
        copied.explained(0),
    ):
        h5py.File(copied.path(0), "r")["rgb"][0, 0, 0]


def test_pictures_of_other_states_are_drawn_again(
    finished: Images, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copied = copy(finished, tmp_path)
    (copied.directory / "manifest.json").unlink()
    with h5py.File(copied.path(0), "r+") as file:
        file.attrs["states_sha256"] = "0" * 64
    generation.make(copied, workers=1)
    assert "shard-00000.h5 is damaged (it shows other states" in caplog.text


def test_pictures_of_other_states_are_not_read(finished: Images, tmp_path: Path) -> None:
    copied = copy(finished, tmp_path)
    with h5py.File(copied.path(0), "r+") as file:
        file.attrs["states_sha256"] = "0" * 64
    frames = FrameDataset([(copied, copied.states.load())], split="train", resolution=16)
    with pytest.raises(CophyError, match=r"shard-00000\.h5 is damaged \(it shows other states"):
        frames[0]


class Guess:
    """Sees nothing."""

    name, source, render = "guess", Path("guess.ckpt"), RENDER

    def __call__(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((len(rgb), 4, 3)), np.zeros((len(rgb), 4))


def test_estimates_of_other_pictures_are_made_again(
    finished: Images, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    copied = copy(finished, tmp_path)
    estimates = Estimates(copied, Guess())
    generation.make(estimates, workers=1)
    copied.directory.joinpath("manifest.json").write_text(
        finished.directory.joinpath("manifest.json").read_text().replace(copied.checksums()["shard-00001.h5"], "0" * 64)
    )
    with pytest.raises(CophyError, match=r"shard-00001\.h5 is damaged \(it is of other states or pictures"):
        estimates.load()
    for path in copied.directory.glob("*"):
        path.unlink()
    assert estimates.load()["position"].shape == (40, 2, 30, 4, 3)  # pictures may go once they were seen


def test_frames_are_those_of_the_split_they_are_asked_for(tiny_data: Path) -> None:
    chosen = settings("train", "scenario=collision", "size=tiny")
    render = RenderSettings(["rgb"], 16, Backend.tiny)
    data = FrameDataModule(
        scenario=chosen.scenario, split=chosen.split, num_objects=None, size=chosen.size, seed=0, data_dir=tiny_data, source=chosen.source, render=render,
        resolution=16, num_frames=100, batch_size=10, workers=2,
    )  # fmt: skip
    data.prepare_data()
    data.setup()
    assert (len(data.train), len(data.val), len(data.test)) == (100, 10, 10)
    arrays = data.train.sources[0][1]
    for frames, split in ((data.train, 0), (data.val, 1), (data.test, 2)):
        assert set(arrays["split"][frames.index[:, 1]]) == {split}
    batch = next(iter(data.train_dataloader()))
    assert batch.image.shape == (10, 3, 16, 16)
    assert batch.presence.sum(dim=1).tolist() == [2] * 10
    item = data.train[3]
    _, row, sequence, frame = data.train.index[3].tolist()
    np.testing.assert_array_equal(item.position, arrays["states"][row, sequence, 4 * frame, :, :3])
