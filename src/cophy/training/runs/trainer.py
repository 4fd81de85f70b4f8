"""Lightning's Trainer as every run uses it: TensorBoard, the best and the last checkpoint, figures."""

import warnings
from typing import Any

import lightning as L
from lightning.pytorch.callbacks import LearningRateMonitor, ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger

from cophy.errors import CophyError
from cophy.training.callbacks import ResumeHint, SaveOrigin
from cophy.training.runs.devices import plugins
from cophy.training.runs.identity import Run
from cophy.training.trained.checkpoints import Origin

# the whole data set lies in memory and is sliced: Lightning's advice to add workers does not apply
warnings.filterwarnings("ignore", ".*does not have many workers.*")
warnings.filterwarnings("ignore", "The `srun` command is available.*")  # runs on a cluster are started by submitit
warnings.filterwarnings("ignore", "Checkpoint directory .* exists and is not empty")  # it is the run's own
warnings.filterwarnings("ignore", ".*LeafSpec.*")  # of Lightning 2.6 with torch 2.13, nothing a user can do


def tensorboard(run: Run) -> TensorBoardLogger:
    """Curves, figures and final metrics go to <directory>/tensorboard."""
    return TensorBoardLogger(run.directory, name="tensorboard", version="", default_hp_metric=False)


def with_epochs(arguments: dict[str, Any], factor: int) -> dict[str, Any]:
    """The arguments, with so many times as many epochs; no limit stays none."""
    return arguments | {"max_epochs": max(factor * arguments["max_epochs"], -1)}


def make_trainer(run: Run, origin: Origin, watching: list[L.Callback], arguments: dict[str, Any]) -> L.Trainer:
    """A Trainer that keeps the checkpoint with the smallest validation MSE, and the last one.

    Args:
        run: Says where everything goes.
        origin: Goes into every checkpoint.
        watching: Callbacks of this run: what draws, and what remembers.
        arguments: Of `lightning.Trainer` (conf/trainer/).
    """
    callbacks = [
        ModelCheckpoint(run.checkpoints, filename="best", monitor="val/mse", enable_version_counter=False),
        # apart from the best: with save_last=True Lightning 2.6 writes the last one only when it is the best
        ModelCheckpoint(run.checkpoints, filename="last", enable_version_counter=False),
        SaveOrigin(origin),
        LearningRateMonitor("epoch"),
        *watching,
        ResumeHint(run.checkpoints / "last.ckpt"),
    ]
    try:
        return L.Trainer(
            logger=tensorboard(run),
            callbacks=callbacks,
            default_root_dir=run.directory,
            plugins=plugins(),
            use_distributed_sampler=False,  # the datamodules share batches among devices themselves
            **arguments,
        )
    except TypeError as error:  # an argument that Lightning does not have, given with +trainer.
        raise CophyError(f"trainer: {error}") from error
