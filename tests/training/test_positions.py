"""What a predictor sees when positions are estimates, and how it is judged then."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cophy.dataset.counterfactual import with_estimates
from cophy.errors import CophyError
from cophy.training.derenderers import TrainedDerenderer, find
from cophy.types import Batch


def estimates(batch: Batch, presence_logit: np.ndarray) -> dict[str, np.ndarray]:
    truth = torch.stack([batch.observed, torch.cat([batch.initial[:, None], batch.target], dim=1)], dim=1)
    return {"position": truth.numpy() + 0.125, "presence_logit": presence_logit.astype(np.float32)}


def test_estimates_replace_what_is_seen_and_nothing_of_what_is_asked(tower_batch: Batch) -> None:
    presence = torch.stack([tower_batch.observed_presence, tower_batch.presence], dim=1)[:, :, None].expand(
        -1, 2, 30, 4
    )
    seen = with_estimates(tower_batch, estimates(tower_batch, np.where(presence, 5.0, -5.0)))
    inside = tower_batch.presence[..., None]
    torch.testing.assert_close(seen.initial, (tower_batch.initial + 0.125) * inside)
    torch.testing.assert_close(
        seen.observed[:, 7], (tower_batch.observed[:, 7] + 0.125) * tower_batch.observed_presence[..., None]
    )
    for name in ("presence", "observed_presence", "target", "target_presence", "stable", "confounders"):
        torch.testing.assert_close(getattr(seen, name), getattr(tower_batch, name))


def test_presence_is_that_of_most_frames_in_ab_and_of_the_only_frame_in_c(tower_batch: Batch) -> None:
    logit = np.full((len(tower_batch.initial), 2, 30, 4), -1.0)
    logit[:, 0, :16, 0] = 1.0  # 16 of 30 frames
    logit[:, 0, :15, 1] = 1.0  # half of them
    logit[:, 1, 0, 2] = 1.0
    logit[:, 1, 1:, 3] = 1.0  # only after C
    seen = with_estimates(tower_batch, estimates(tower_batch, logit))
    assert seen.observed_presence[0].tolist() == [True, False, False, False]
    assert seen.presence[0].tolist() == [False, False, True, False]
    assert not seen.initial[:, [0, 1, 3]].any()


def test_without_a_derenderer_the_error_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no de-renderer of balls with 4 objects .* model=derenderer scenario=balls"):
        find(tmp_path, "balls", {4})


def test_what_is_no_checkpoint_is_refused_without_running_it(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no\.ckpt is no file"):
        TrainedDerenderer(tmp_path / "no.ckpt")
    (tmp_path / "bad.ckpt").write_bytes(b"cos\nsystem\n(S'touch hacked'\ntR.")
    with pytest.raises(CophyError, match=r"bad\.ckpt is no checkpoint"):
        TrainedDerenderer(tmp_path / "bad.ckpt")
    assert not (tmp_path / "hacked").exists()
