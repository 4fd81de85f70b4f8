"""De-renderers from checkpoints, and the one that a run needs."""

from pathlib import Path

import pytest

from cophy.errors import CophyError
from cophy.training.trained.trained_derenderer import TrainedDerenderer, find_derenderer


def test_without_a_derenderer_the_error_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no de-renderer of balls with 4 objects .* model=derenderer scenario=balls"):
        find_derenderer(tmp_path, "balls", {4}, "4to4")


def test_what_is_no_checkpoint_is_refused_without_running_it(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no\.ckpt is no file"):
        TrainedDerenderer(tmp_path / "no.ckpt")
    (tmp_path / "bad.ckpt").write_bytes(b"cos\nsystem\n(S'touch hacked'\ntR.")
    with pytest.raises(CophyError, match=r"bad\.ckpt is no checkpoint"):
        TrainedDerenderer(tmp_path / "bad.ckpt")
    assert not (tmp_path / "hacked").exists()
