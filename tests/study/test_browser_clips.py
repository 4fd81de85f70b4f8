"""Clips that browsers play are whole, or not there."""

import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from cophy.atomic_files import appearing_whole
from cophy.errors import CophyError
from cophy.study import clips

FRAMES = np.random.default_rng(0).integers(0, 255, size=(30, 64, 64, 3), dtype=np.uint8)


def write(path: Path) -> None:
    with appearing_whole(path) as temporary:
        clips._write_clip(temporary, FRAMES, 25)


@contextmanager
def files_of_at_most(num_bytes: int) -> Iterator[None]:
    """As where a disk is full: what is beyond is not written, and OpenCV does not say so."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_clip_has_all_its_frames(tmp_path: Path) -> None:
    write(tmp_path / "1-ab.webm")
    assert clips._count_frames(tmp_path / "1-ab.webm") == len(FRAMES)
    assert [path.name for path in tmp_path.iterdir()] == ["1-ab.webm"]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_clip_that_is_cut_is_not_kept(share: float, tmp_path: Path) -> None:
    write(tmp_path / "whole.webm")
    size = (tmp_path / "whole.webm").stat().st_size
    with files_of_at_most(int(share * size)), pytest.raises(CophyError, match="of 30 frames could be written"):
        write(tmp_path / "1-ab.webm")
    assert [path.name for path in tmp_path.iterdir()] == ["whole.webm"]


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(1, 1, 0))
    with pytest.raises(OSError, match="No space left"):
        write(tmp_path / "1-ab.webm")
    assert not list(tmp_path.iterdir())
