"""Carry a run out: train (or adopt a training that was the same), test the best checkpoint, write the results.

What a run trains and tests: a de-renderer (images -> positions) or a predictor (positions of AB, and C -> D).
"""

import logging
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import lightning as L
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities.exceptions import SIGTERMException
from torch import nn

from cophy.atomic_files import sha256
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.dataset.frames import FrameDataModule
from cophy.errors import CophyError
from cophy.models.derenderer import Derenderer
from cophy.training import reuse
from cophy.training.augmentation import matrices_of
from cophy.training.callbacks import BestValidation, Stopwatch
from cophy.training.checkpoints import Origin, flatten
from cophy.training.derenderer import DerenderingModule
from cophy.training.evaluation import evaluate, mse_of_copies
from cophy.training.figures import Curves, DerenderingFigures, PredictionFigures
from cophy.training.predictor import PredictionModule
from cophy.training.probe import Probed, estimate, probe, warn_if_constant
from cophy.training.reuse import Trained
from cophy.training.run import (
    Claim,
    Measured,
    Run,
    first_decides,
    is_first,
    meet,
    was_queued_again,
    write_metrics,
    write_predictions,
)
from cophy.training.settings import Training
from cophy.training.trainer import finishing, forget_curves, log_results, loggers_of, make_trainer

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Stage:
    """Data and module of a run.

    Attributes:
        data: Datamodule, set up.
        module: What is trained and tested.
        figures: Callback that draws validation examples.
        measure: After a test: writes what was predicted, and measures it.
        derenderer: Name of the one whose estimates are seen, or None.
        epochs_factor: How many times as many epochs it is trained as `trainer.max_epochs` says.
    """

    data: CounterfactualDataModule | FrameDataModule
    module: PredictionModule | DerenderingModule
    figures: L.Callback
    measure: Callable[[], Measured]
    derenderer: str | None = None
    epochs_factor: int = 1

    @property
    def learns(self) -> bool:
        """Whether there is anything to train."""
        return any(parameter.requires_grad for parameter in self.module.network.parameters())


def derendering_stage(
    network: Derenderer, data: FrameDataModule, training: Training, *, figures_every_n_epochs: int
) -> Stage:
    """Train a de-renderer on single frames (paper, appendix).

    Args:
        network: Learns positions in units of their spread over the training frames, which is set here.
        data: Set up.
        training: How it is optimised.
        figures_every_n_epochs: How often figures are drawn.
    """
    network.scale_(*data.train.position_statistics())
    module = DerenderingModule(network, training)
    figures = DerenderingFigures(data.val, data.scenario, figures_every_n_epochs)
    return Stage(data, module, figures, lambda: Measured(module.tested, data.test.pairs))


def prediction_stage(
    network: nn.Module, data: CounterfactualDataModule, training: Training, run: Run, *, figures_every_n_epochs: int
) -> Stage:
    """Train a predictor of D (paper Sec. 4).

    Args:
        network: From `Inputs` to `Prediction`.
        data: Set up.
        training: How it is optimised.
        run: In whose directory the predictions go.
        figures_every_n_epochs: How often figures are drawn.
    """
    scenario = data.scenario
    augmentations = matrices_of(scenario, training.augmentation)
    module = PredictionModule(
        network, training, scenario, augmentations=augmentations, missed_position=data.mean_position, seed=data.seed
    )

    def measure() -> Measured:
        prediction, batch = module.tested
        values = evaluate(prediction, batch.targets, scenario)
        if prediction.confounder_estimate is not None:
            tested = Probed(prediction.confounder_estimate, batch.targets)
            warn_if_constant(tested)
            if data.knows_confounders and not data.estimated:
                train = data.train.batch
                fitted = estimate(network, train.inputs, batch_size=training.batch_size)
                assert fitted is not None
                values |= probe(Probed(fitted, train.targets), tested)
        write_predictions(run.directory, prediction, batch.targets)
        copies = mse_of_copies(batch, scenario, data.mean_position)
        return Measured(values, batch.targets.pair.numpy(), copies)

    figures = PredictionFigures(data.val.batch, scenario, figures_every_n_epochs)
    derenderer = data.derenderer.name if data.derenderer else None
    return Stage(data, module, figures, measure, derenderer, data.split.epochs_factor)


@dataclass(frozen=True)
class Plan:
    """How a run is trained.

    Attributes:
        trainer: Arguments of `lightning.Trainer`; max_epochs are those of this run.
        loggers: What `logger=` chose.
        seed: Of the training.
        threads: Of torch.
        reuse: Whether a finished training that was the same is adopted.
        resume: Checkpoint to go on from, or None.
        predictor: Checkpoint of this training, which is tested instead of training; or None.
        started: `time.monotonic()` when the run began.
    """

    trainer: dict[str, Any]
    loggers: dict[str, Any]
    seed: int
    threads: int
    reuse: bool
    resume: Path | None
    predictor: Path | None
    started: float

    @property
    def is_trial(self) -> bool:
        """Whether it only takes a step, and leaves no results."""
        return bool(self.trainer["fast_dev_run"])


class Watched(NamedTuple):
    """What a training is asked for when it ends; both remember across stops."""

    best_epoch: BestValidation
    stopwatch: Stopwatch


def carry_out(claim: Claim, stage: Stage, plan: Plan, origin: Origin) -> dict[str, float]:
    """Train, test and write the results.

    Args:
        claim: The run's names and place.
        stage: Data and module.
        plan: How it is trained.
        origin: What goes into the checkpoints.

    Returns:
        The validation metrics of the epoch whose weights were tested; nothing from a trial, or where nothing is trained.
    """
    run = claim.run
    watched = Watched(BestValidation(run.checkpoints / "best.ckpt"), Stopwatch(str(run.place)))
    loggers = loggers_of(run, plan.loggers)
    with finishing(loggers):
        trainer = make_trainer(run, origin, [stage.figures, *watched], loggers, plan.trainer)
        meet(trainer, stage.module)
        best, trained = None, Trained(0.0, {}, 0)
        for key, given in (("ckpt", plan.resume), ("predictor", plan.predictor)):
            if given is not None and not stage.learns:
                raise CophyError(f"{key}={given}: {run.model} has nothing to train or to restore")
        if not plan.is_trial:  # a trial leaves all as it is
            claim.begin(tests_checkpoint=plan.predictor is not None)
        if plan.predictor is not None:
            best = plan.predictor
        elif stage.learns:
            trained = _train(trainer, watched, run, stage, plan, origin)
            best = None if plan.is_trial else run.checkpoints / "best.ckpt"
        else:
            forget_curves(trainer)
        if trainer.state.fn != TrainerFn.FITTING:
            # nothing was trained here, so pictures and validation metrics come from this
            trainer.loggers = [each for each in trainer.loggers if not (isinstance(each, Curves) and each.earlier)]
            _log_names(trainer, run, plan, origin)
            found = trainer.validate(stage.module, stage.data, ckpt_path=best, weights_only=True, verbose=False)
            if plan.predictor is not None:
                trained = trained._replace(validation={name: value for part in found for name, value in part.items()})
        trainer.test(stage.module, stage.data, ckpt_path=best, weights_only=True, verbose=False)
        if plan.is_trial:
            return {}
        if not is_first():
            return trained.validation
        measured = stage.measure()
        about = {
            "dataset_ids": stage.data.dataset_ids,
            "derenderer": stage.derenderer,
            "predictor": None if plan.predictor is None else sha256(plan.predictor)[:8],
            "num_train": len(stage.data.train),
            "num_test": len(measured.pairs),
            "max_epochs": plan.trainer["max_epochs"],
            "training_seconds": trained.seconds,
            "resumed": trained.resumed,
            "validation": trained.validation,
        }
        metrics = write_metrics(run, measured, about | {"wall_seconds": round(time.monotonic() - plan.started, 1)})
        log_results(trainer.loggers, metrics, trainer.global_step)
        return trained.validation


def compared(run: Run, origin: Origin, trainer: dict[str, Any]) -> dict[str, Any]:
    """What TensorBoard compares runs by: names, and the keys of model, training and trainer.

    Args:
        run: Whose names are shown.
        origin: Knows model and training.
        trainer: Arguments of `lightning.Trainer`.
    """
    return run.names() | flatten({"model": origin.model, "training": origin.training, "trainer": trainer})


def _log_names(trainer: L.Trainer, run: Run, plan: Plan, origin: Origin) -> None:
    for logger in trainer.loggers:
        logger.log_hyperparams(compared(run, origin, plan.trainer))


def _train(trainer: L.Trainer, watched: Watched, run: Run, stage: Stage, plan: Plan, origin: Origin) -> Trained:
    """Fit, go on where the same training was stopped, or adopt the checkpoints of one that was the same."""
    given, anew = plan.resume, not plan.reuse and not was_queued_again()

    def start() -> Trained | tuple[str, int, Path | None]:
        """A finished training; or the fingerprint of this one, how often it was stopped, and what it goes on from."""
        if plan.is_trial:
            return "", 0, given
        settings = {"trainer": plan.trainer, "seed": plan.seed, "threads": plan.threads}
        wanted = reuse.fingerprint(stage.module.network, origin, settings, resumed_from=given)
        if not anew and (found := reuse.find_checkpoints(run, wanted)) is not None:
            log.info("trained already, on the same data with the same settings: %s (reuse=false trains again)", found)
            if found.resolve() != run.checkpoints.resolve():
                forget_curves(trainer)
            return reuse.adopt(found, run)
        if stopped := reuse.begin(run, wanted, anew=anew, given=given):
            log.info("goes on where it was stopped: %s (reuse=false trains again)", run.checkpoints / "last.ckpt")
            return wanted, stopped + (given is not None), run.checkpoints / "last.ckpt"
        moved = given is not None and not given.exists()
        return wanted, int(given is not None), run.checkpoints / reuse.STOPPED if moved else given

    known = first_decides(trainer, start)
    if isinstance(known, Trained):
        return known
    wanted, resumed, resume = known
    if not resumed:
        forget_curves(trainer)
    _log_names(trainer, run, plan, origin)
    try:
        trainer.fit(stage.module, stage.data, ckpt_path=resume, weights_only=True)
    except MisconfigurationException as error:
        raise CophyError(f"trainer: {error}") from error
    except SIGTERMException as error:
        # as of a process that it ends; of several, Lightning kills the first where another ends with a failure
        raise SystemExit(128 + signal.SIGTERM if is_first() else 0) from error
    trained = Trained(round(watched.stopwatch.seconds, 1), watched.best_epoch.metrics, resumed)
    if is_first() and not plan.is_trial:
        reuse.record(run, wanted, trained)
    return trained
