"""The log shows the progress of a training if there is no progress bar."""

import logging
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from lightning.pytorch.trainer.states import TrainerFn

from cophy.errors import CophyError
from cophy.training import callbacks
from cophy.training.callbacks import BestValidation, ResumeHint, Stopwatch


@pytest.mark.parametrize(("seconds", "num_messages"), [(0.0, 3), (3600.0, 0)])
def test_progress_is_logged_at_intervals(
    seconds: float, num_messages: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(callbacks, "LOG_EVERY_S", seconds)
    measured = {"val/mse": torch.tensor(0.25)}
    trainer = SimpleNamespace(
        progress_bar_callback=None, is_global_zero=True, max_epochs=3, callback_metrics=measured, current_epoch=0
    )
    watch = Stopwatch("balls/4to4/in")
    with caplog.at_level(logging.INFO):
        for trainer.current_epoch in range(3):
            watch.on_train_epoch_end(trainer, None)
    assert len(caplog.messages) == num_messages
    if num_messages:
        assert caplog.messages[1].startswith("balls/4to4/in: epoch 2 of 3, val/mse 0.2500, ")


@pytest.mark.parametrize(
    ("error", "has_checkpoint", "logged"),
    [
        (KeyboardInterrupt(), False, "stopped in epoch 0, before the first checkpoint"),
        (CophyError("metrics.x returns float"), False, ""),
        (CophyError("metrics.x returns float"), True, "run the same command to continue"),
    ],
)
def test_a_users_error_before_the_first_checkpoint_is_all_that_is_said(
    error: BaseException, has_checkpoint: bool, logged: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "last.ckpt"
    if has_checkpoint:
        path.touch()
    trainer = SimpleNamespace(current_epoch=0, state=SimpleNamespace(fn=TrainerFn.TESTING))
    ResumeHint(path).on_exception(trainer, None, error)
    assert not caplog.text  # a test that fails stops no training
    trainer.state.fn = TrainerFn.FITTING
    ResumeHint(path).on_exception(trainer, None, error)
    assert logged in caplog.text
    assert bool(caplog.text) == bool(logged)


def test_a_metric_that_a_sweep_cannot_optimise_is_named_after_the_first_validation() -> None:
    callback = BestValidation(SimpleNamespace(), "val/msee")
    trainer = SimpleNamespace(callback_metrics={"val/mse": torch.tensor(1.0)}, sanity_checking=True)
    callback.on_validation_end(trainer, None)  # of a few batches, which may lack a metric
    trainer.sanity_checking = False
    with pytest.raises(CophyError, match=r"optimized_metric=val/msee is not among val/mse"):
        callback.on_validation_end(trainer, None)
