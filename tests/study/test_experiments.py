"""Images and clips show C and AB, never D; clips are whole or do not exist."""

import resource
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from cophy.atomic_files import appearing_whole
from cophy.dataset.images import render_sequence
from cophy.drawing import files
from cophy.drawing.files import read_frames, write_video
from cophy.errors import CophyError
from cophy.scenario.rendering import Renderer
from cophy.study.experiments import CLIP, CODEC, IMAGE, StudyExperiments

FRAMES = np.random.default_rng(0).integers(0, 255, size=(12, 64, 64, 3), dtype=np.uint8)


def write(path: Path) -> None:
    with appearing_whole(path) as temporary:
        write_video(temporary, FRAMES, frame_rate_hz=25, codec=CODEC)


def test_images_show_c_and_clips_show_ab(experiments: StudyExperiments) -> None:
    names = {f"{experiment}-{name}" for experiment in experiments.shown for name in (IMAGE, CLIP)}
    assert {path.name for path in experiments.image_directory.iterdir()} == names
    experiment = experiments.shown[0]
    with Renderer(experiments.scenario, 64) as renderer:
        first = render_sequence(renderer, experiments.arrays, experiment, 1, [0]).rgb[0]
        observed = render_sequence(renderer, experiments.arrays, experiment, 0, slice(None)).rgb
    assert (read_frames(experiments.file(experiment, IMAGE))[0] == first).all()
    video = cv2.VideoCapture(str(experiments.file(experiment, CLIP)))
    frames = [cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2RGB) for _ in observed]
    assert np.abs(np.stack(frames).astype(int) - observed).mean() < 5
    assert not video.read()[0]


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_a_truncated_clip_is_removed(share: float, tmp_path: Path) -> None:
    """OpenCV does not report a full disk; here, files are limited in size."""
    write(tmp_path / "whole.webm")
    assert files._count_frames(tmp_path / "whole.webm") == len(FRAMES)
    size = (tmp_path / "whole.webm").stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(share * size), hard))
    try:
        with pytest.raises(CophyError, match="of 12 frames were written"):
            write(tmp_path / "1-ab.webm")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.name for path in tmp_path.iterdir()] == ["whole.webm"]


def test_a_clip_that_cannot_be_created_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere/1-ab\.webm"):
        write_video(tmp_path / "nowhere" / "1-ab.webm", FRAMES, frame_rate_hz=25, codec=CODEC)


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(1, 1, 0))
    with pytest.raises(OSError, match="No space left"):
        write(tmp_path / "1-ab.webm")
    assert not list(tmp_path.iterdir())
