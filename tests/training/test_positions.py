"""What a predictor sees when positions are estimates, and how it is judged then."""

from pathlib import Path

import numpy as np
import pytest
import torch

from cophy.dataset.counterfactual import with_estimates
from cophy.errors import CophyError
from cophy.models.copying import CopyB, CopyC
from cophy.training.derenderers import TrainedDerenderer, find
from cophy.training.prediction import PredictionModule
from cophy.types import Batch
from tests.conftest import settings, tiny_spec

SCENARIO = tiny_spec("blocktower").scenario


def estimates(batch: Batch, presence_logit: np.ndarray) -> dict[str, np.ndarray]:
    truth = torch.stack([batch.observed, torch.cat([batch.initial[:, None], batch.target], dim=1)], dim=1)
    return {"position": truth.numpy() + 0.125, "presence_logit": presence_logit.astype(np.float32)}


def test_estimates_replace_what_is_seen_and_nothing_of_what_is_asked(tower_batch: Batch) -> None:
    presence = torch.stack([tower_batch.observed_presence, tower_batch.presence], dim=1)[:, :, None].expand(
        -1, 2, 30, 4
    )
    seen = with_estimates(tower_batch, estimates(tower_batch, np.where(presence, 5.0, -5.0)), SCENARIO)
    inside = tower_batch.presence[..., None]
    torch.testing.assert_close(seen.initial, (tower_batch.initial + 0.125) * inside)
    torch.testing.assert_close(
        seen.observed[:, 7], (tower_batch.observed[:, 7] + 0.125) * tower_batch.observed_presence[..., None]
    )
    for name in (
        "presence",
        "observed_presence",
        "target",
        "target_initial",
        "target_presence",
        "stable",
        "confounders",
    ):
        torch.testing.assert_close(getattr(seen, name), getattr(tower_batch, name))


def test_presence_is_that_of_most_frames_in_ab_and_of_the_only_frame_in_c(tower_batch: Batch) -> None:
    logit = np.full((len(tower_batch.initial), 2, 30, 4), -1.0)
    logit[:, 0, :16, 0] = 1.0  # 16 of 30 frames
    logit[:, 0, :15, 1] = 1.0  # half of them
    logit[:, 1, 0, 2] = 1.0
    logit[:, 1, 1:, 3] = 1.0  # only after C
    seen = with_estimates(tower_batch, estimates(tower_batch, logit), SCENARIO)
    assert seen.observed_presence[0].tolist() == [True, False, False, False]
    assert seen.presence[0].tolist() == [False, False, True, False]
    assert not seen.initial[:, [0, 1, 3]].any()


def test_stability_of_ab_is_what_estimates_look_like(tower_batch: Batch) -> None:
    presence = np.full((len(tower_batch.initial), 2, 30, 4), 1.0)
    moving = estimates(tower_batch, presence)
    moving["position"] = np.zeros_like(moving["position"])
    moving["position"][:, 0, 10:, 1, 0] = 0.03  # 3 cm in a fifth of a second: 0.15 m/s
    stable = with_estimates(tower_batch, moving, SCENARIO).observed_stable
    assert not stable[:, 9, 1].any()
    stable[:, 9, 1] = True
    assert stable.all()


def test_copy_b_leaves_what_was_missed_in_ab_where_it_is_in_c(tower_batch: Batch) -> None:
    missed = tower_batch.observed_presence.clone()
    missed[:, 0] = False
    position = CopyB()(tower_batch._replace(observed_presence=missed)).position
    torch.testing.assert_close(position[:, :, 0], tower_batch.initial[:, None, 0].expand(-1, 29, -1))
    torch.testing.assert_close(
        position[:, :, 1:][:, :, missed[0, 1:]], tower_batch.observed[:, 1:, 1:][:, :, missed[0, 1:]]
    )


def test_a_missed_object_counts_as_predicted_at_the_mean_of_training(tower_batch: Batch) -> None:
    chosen = settings("train")
    module = PredictionModule(CopyC(), chosen.training, chosen.scenario, np.eye(2)[None], config={})
    module.missed_position.copy_(torch.tensor([1.0, 2.0, 3.0]))
    presence = tower_batch.presence.clone()
    presence[:, 2] = False
    position = module(tower_batch._replace(presence=presence)).position
    missed = tower_batch.target_presence[:, 2]
    assert missed.any()
    assert (position[missed][:, :, 2] == torch.tensor([1.0, 2.0, 3.0])).all()
    torch.testing.assert_close(position[:, :, 1], tower_batch.initial[:, None, 1].expand(-1, 29, -1))


def test_without_a_derenderer_the_error_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no de-renderer of balls with 4 objects .* model=derenderer scenario=balls"):
        find(tmp_path, "balls", {4}, "4to4")


def test_what_is_no_checkpoint_is_refused_without_running_it(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"no\.ckpt is no file"):
        TrainedDerenderer(tmp_path / "no.ckpt")
    (tmp_path / "bad.ckpt").write_bytes(b"cos\nsystem\n(S'touch hacked'\ntR.")
    with pytest.raises(CophyError, match=r"bad\.ckpt is no checkpoint"):
        TrainedDerenderer(tmp_path / "bad.ckpt")
    assert not (tmp_path / "hacked").exists()
