"""Checkpoints are there whole or not at all."""

import errno
from pathlib import Path

import pytest
import torch

from cophy.training.trained.checkpoints import WholeCheckpoints


def test_a_checkpoint_that_cannot_be_written_leaves_the_older_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "checkpoints" / "best.ckpt"
    WholeCheckpoints().save_checkpoint({"weights": torch.ones(3)}, path)
    before, write = path.read_bytes(), Path.write_bytes

    def half_then_full(self: Path, content: bytes) -> int:
        write(self, content[: len(content) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half_then_full)
    with pytest.raises(OSError, match="No space left"):
        WholeCheckpoints().save_checkpoint({"weights": torch.zeros(3)}, path)
    assert [file.read_bytes() for file in path.parent.iterdir()] == [before]
