"""Carry a run out: train (or adopt a training that was the same), test the best checkpoint, write the results."""

import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning as L

from cophy.errors import CophyError
from cophy.training.callbacks import BestValidation
from cophy.training.runs import reuse
from cophy.training.runs.identity import Run
from cophy.training.runs.results import write_metrics
from cophy.training.runs.reuse import Trained
from cophy.training.runs.stages import Stage
from cophy.training.runs.trainer import make_trainer
from cophy.training.trained.checkpoints import Origin
from cophy.training.trained.resuming import flatten

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Plan:
    """How a run is trained.

    Attributes:
        trainer: Arguments of `lightning.Trainer`; max_epochs are those of this run.
        seed: Of the training.
        threads: Of torch.
        reuse: Whether a finished training that was the same is adopted.
        resume: Checkpoint to go on from, or None.
        started: `time.monotonic()` when the run began.
    """

    trainer: dict[str, Any]
    seed: int
    threads: int
    reuse: bool
    resume: Path | None
    started: float

    @property
    def is_trial(self) -> bool:
        """Whether it only takes a step, and leaves no results."""
        return bool(self.trainer["fast_dev_run"])


def carry_out(run: Run, stage: Stage, plan: Plan, origin: Origin) -> dict[str, float]:
    """Train, test and write the results.

    Args:
        run: Its names and place.
        stage: Data and module.
        plan: How it is trained.
        origin: What goes into the checkpoints.

    Returns:
        The validation metrics of the epoch whose weights were tested; nothing from a trial, or where nothing is trained.
    """
    best_epoch = BestValidation()
    trainer = make_trainer(run, origin, [stage.figures, best_epoch], plan.trainer)
    assert trainer.logger is not None  # TensorBoard, or of a trial one that does nothing
    trainer.logger.log_hyperparams(compared(run, origin, plan.trainer), {"test/mse": float("nan")})
    best, trained = None, Trained(0.0, {})
    if stage.learns:
        trained = _train(trainer, best_epoch, run, stage, plan, origin)
        best = None if plan.is_trial else run.checkpoints / "best.ckpt"
    elif plan.resume is not None:
        raise CophyError(f"ckpt={plan.resume}: {run.model} has nothing to train or to restore")
    trainer.test(stage.module, stage.data, ckpt_path=best, weights_only=True, verbose=False)
    if plan.is_trial:
        return {}
    about = {
        "dataset_ids": stage.data.dataset_ids,
        "derenderer": stage.derenderer,
        "num_train": len(stage.data.train),
        "num_test": len(stage.data.test),
        "max_epochs": plan.trainer["max_epochs"],
        "training_seconds": trained.seconds,
        "validation": trained.validation,
    }
    measured = stage.measure()
    metrics = write_metrics(run, measured, about | {"wall_seconds": round(time.monotonic() - plan.started, 1)})
    trainer.logger.log_metrics({f"test/{name}": value for name, value in metrics.items()}, trainer.global_step)
    trainer.logger.save()
    return trained.validation


def compared(run: Run, origin: Origin, trainer: dict[str, Any]) -> dict[str, Any]:
    """What TensorBoard compares runs by: names, and the keys of model, training and trainer.

    Args:
        run: Whose names are shown.
        origin: Knows model and training.
        trainer: Arguments of `lightning.Trainer`.
    """
    return run.names() | flatten({"model": origin.model, "training": origin.training, "trainer": trainer})


def _train(
    trainer: L.Trainer, best_epoch: BestValidation, run: Run, stage: Stage, plan: Plan, origin: Origin
) -> Trained:
    """Fit, or adopt the checkpoints of a training that was the same."""
    network = stage.module.network
    of_training = reuse.fingerprint(network, origin, trainer=plan.trainer, seed=plan.seed, threads=plan.threads)
    anew = plan.resume is None and not plan.is_trial
    if plan.reuse and anew and (found := reuse.find_checkpoints(run, of_training)) is not None:
        log.info("trained already, on the same data with the same settings: %s (reuse=false trains again)", found)
        return reuse.adopt(found, run)
    if plan.resume is None:
        reuse.forget_checkpoints(run)
    start = time.monotonic()
    trainer.fit(stage.module, stage.data, ckpt_path=plan.resume, weights_only=True)
    trained = Trained(round(time.monotonic() - start, 1), best_epoch.metrics)
    if anew:
        reuse.record(run, of_training, trained)
    return trained
