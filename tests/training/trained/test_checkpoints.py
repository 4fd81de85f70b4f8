"""Checkpoints are there whole or not at all."""

import errno
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from cophy.errors import CophyError
from cophy.training.checkpoints import Origin, WholeCheckpoints, read_bytes

NAMES: dict[str, dict[str, str]] = {"model": {"_target_": "a"}, "scenario": {"name": "b"}, "split": {"name": "c"}}
ORIGIN = Origin(
    **NAMES, training={}, size={}, data_seed=0, positions="ground_truth", num_objects=None, render={}, trained_on=[]
)


def test_a_checkpoint_that_cannot_be_written_leaves_the_older_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "checkpoints" / "best.ckpt"
    WholeCheckpoints(ORIGIN, tmp_path).save_checkpoint({"weights": torch.ones(3)}, path)
    before, write = path.read_bytes(), Path.write_bytes

    def half_then_full(self: Path, content: bytes) -> int:
        write(self, content[: len(content) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half_then_full)
    with pytest.raises(OSError, match="No space left"):
        WholeCheckpoints(ORIGIN, tmp_path).save_checkpoint({"weights": torch.zeros(3)}, path)
    assert [file.read_bytes() for file in path.parent.iterdir()] == [before]


def test_a_flipped_byte_is_noticed_or_changes_nothing(tmp_path: Path) -> None:
    path, rng = tmp_path / "best.ckpt", np.random.default_rng(0)
    saved = {"weights": torch.arange(300.0), "epoch": 3}
    WholeCheckpoints(ORIGIN, tmp_path).save_checkpoint(saved, path)
    content, noticed = path.read_bytes(), 0
    start = content.index(torch.arange(300.0).numpy().tobytes())
    for place in [start + 5, *rng.integers(0, len(content), 300).tolist()]:
        path.write_bytes(content[:place] + bytes([content[place] ^ 64]) + content[place + 1 :])
        try:
            found = WholeCheckpoints(ORIGIN, tmp_path).load_checkpoint(path, weights_only=True)
        except CophyError:
            noticed += 1
        else:
            assert place != start + 5
            assert found.keys() == saved.keys() | {"origin"}
            assert torch.equal(found["weights"], saved["weights"])
    assert noticed > 100


def test_what_is_larger_than_any_checkpoint_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "best.ckpt"
    path.touch()
    os.truncate(path, 2**40)  # nothing of it lies on the disk
    with pytest.raises(CophyError, match=r"best\.ckpt is no checkpoint of train\.py: it is larger than 4 GiB"):
        read_bytes(path)


def compressed(path: Path, to: Path) -> None:
    with zipfile.ZipFile(path) as stored, zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry in stored.infolist():
            archive.writestr(entry.filename, stored.read(entry))


def overlapping(path: Path, to: Path) -> None:
    """Every part of the checkpoint a hundred times in its list of contents, but once in the file."""
    to.write_bytes(path.read_bytes())
    with zipfile.ZipFile(to, "a") as archive:
        archive.filelist *= 100
        archive._didModify = True


@pytest.mark.parametrize("grow", [compressed, overlapping])
def test_what_would_grow_when_it_is_read_is_refused(tmp_path: Path, grow: Callable[[Path, Path], None]) -> None:
    WholeCheckpoints(ORIGIN, tmp_path).save_checkpoint({"weights": torch.zeros(3000)}, tmp_path / "best.ckpt")
    grow(tmp_path / "best.ckpt", tmp_path / "grows.ckpt")
    with pytest.raises(
        CophyError, match=r"grows\.ckpt is no checkpoint of train\.py: it is compressed, or its parts ov"
    ):
        WholeCheckpoints(ORIGIN, tmp_path).load_checkpoint(tmp_path / "grows.ckpt", weights_only=True)
