"""The log shows the progress of a training if there is no progress bar."""

import logging
from types import SimpleNamespace

import pytest
import torch

from cophy.training import callbacks
from cophy.training.callbacks import Stopwatch


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
