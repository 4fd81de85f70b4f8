"""A run is assembled here: the configuration is taken apart into data, network, stage, plan and origin.

Nothing deeper in the package sees the whole of it.
"""

import logging
import math
import time
from pathlib import Path
from typing import Any

import lightning as L
import torch

from cophy.config import experiments_of
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.dataset.features import DeclaredInputs
from cophy.dataset.frames import FrameDataModule
from cophy.errors import CophyError
from cophy.models.derenderer import Derenderer
from cophy.oracles.run import carry_out_oracle
from cophy.schemas import ESTIMATED, OracleConfig, TrainConfig
from cophy.training.checkpoints import Origin, build_network, check_resumable, check_trained
from cophy.training.execution import Plan, Stage, carry_out, derendering_stage, prediction_stage
from cophy.training.reuse import WITHOUT_EFFECT
from cophy.training.run import Claim, Run, is_first
from cophy.training.trained import TrainedDerenderer, find_derenderer
from cophy.training.trainer import check_arguments, with_epochs


def run_configured(settings: TrainConfig, plain: dict[str, Any], claim: Claim) -> float:
    """Carry out the run that a configuration describes.

    Args:
        settings: The typed configuration.
        plain: The same as plain values, of which the model's arguments and parts of every checkpoint are made.
        claim: Its names and place.

    Returns:
        What a sweep optimises, see `optimized_metric` in conf/train.yaml; NaN where nothing was trained.
    """
    started, run = time.monotonic(), claim.run
    logging.raiseExceptions = False  # a disk that is full stops the log, too: the run says so once, not every line
    if not is_first():  # what there is to say, the first process says
        logging.getLogger("cophy").setLevel(logging.WARNING)
    torch.set_num_threads(settings.threads)
    L.seed_everything(settings.seed, workers=True, verbose=False)
    if isinstance(settings.model, OracleConfig):
        _carry_out_oracle(settings, settings.model, claim, started)
        return math.nan
    check_arguments(plain["trainer"])
    stage, origin = _stage(settings, plain, run)
    plan = Plan(
        trainer=with_epochs(plain["trainer"], stage.epochs_factor),
        loggers=settings.logger,
        seed=settings.seed,
        threads=settings.threads,
        reuse=settings.reuse,
        resume=_path(settings.ckpt),
        predictor=_path(settings.predictor),
        started=started,
    )
    validation, wanted = carry_out(claim, stage, plan, origin), settings.optimized_metric
    if validation and wanted not in validation:
        raise CophyError(f"optimized_metric={wanted} is not among {', '.join(sorted(validation))}")
    return validation.get(wanted, math.nan)


def _path(name: str | None) -> Path | None:
    return None if name is None else Path(name)


def _stage(settings: TrainConfig, plain: dict[str, Any], run: Run) -> tuple[Stage, Origin]:
    """The stage that the network belongs to, its data made and loaded, and what goes into its checkpoints."""
    network, every = build_network(plain["model"]), settings.figures_every_n_epochs
    if isinstance(network, Derenderer):
        if settings.predictor is not None:
            raise CophyError(f"predictor={settings.predictor}: {run.model} predicts nothing")
        frames = _frames(settings, network.resolution)
        origin = _prepare(frames, settings, plain)
        return derendering_stage(network, frames, settings.training, figures_every_n_epochs=every), origin
    experiments = _experiments(settings, run, DeclaredInputs.of(plain["model"]))
    origin = _prepare(experiments, settings, plain)
    return prediction_stage(network, experiments, settings.training, run, figures_every_n_epochs=every), origin


def _prepare(data: CounterfactualDataModule | FrameDataModule, settings: TrainConfig, plain: dict[str, Any]) -> Origin:
    """Make and load the data; a checkpoint that does not fit is refused before."""
    parts = (
        "model",
        "training",
        "scenario",
        "split",
        "size",
        "data_seed",
        "positions",
        "num_objects",
        "render",
        "seed",
    )
    trainer = {key: value for key, value in plain["trainer"].items() if key not in WITHOUT_EFFECT}
    origin = Origin(**{part: plain[part] for part in parts}, trainer=trainer, trained_on=data.trained_on)
    if settings.ckpt is not None:
        check_resumable(Path(settings.ckpt), origin)
    if settings.predictor is not None:
        check_trained(Path(settings.predictor), origin)
    data.prepare_data()
    data.setup()
    return origin


def _frames(settings: TrainConfig, resolution: int) -> FrameDataModule:
    if "rgb" not in settings.render.modalities:
        raise CophyError("a de-renderer sees RGB: use render=rgb or render=all")
    return FrameDataModule(
        experiments_of(settings, settings.num_objects),
        render=settings.render,
        resolution=resolution,
        num_images=settings.num_images,
        data_seed=settings.data_seed,
        batch_size=settings.training.batch_size,
        workers=settings.workers,
        seed=settings.seed,
    )


def _experiments(settings: TrainConfig, run: Run, declared: DeclaredInputs) -> CounterfactualDataModule:
    estimated, learnt = ESTIMATED[settings.positions], settings.training.confounder_weight > 0
    if learnt and "train" in estimated:
        raise CophyError(
            f"positions={settings.positions} does not go with training.confounder_weight: confounders are of true objects"
        )
    if estimated and declared.not_derendered:
        raise CophyError(
            f"positions={settings.positions} does not go with {declared.not_derendered}: no de-renderer estimates it"
        )
    train_set, test_set = (
        experiments_of(settings, [part.num_objects])[0] for part in (settings.split.train, settings.split.test)
    )
    return CounterfactualDataModule(
        settings.split,
        train_set=train_set,
        test_set=test_set,
        batch_size=settings.training.batch_size,
        workers=settings.workers,
        seed=settings.seed,
        derenderer=_derenderer(settings, run) if estimated else None,
        estimated=estimated,
        declared=declared,
        needs_confounders=declared.confounders or learnt,
        num_experiments=settings.training.num_experiments,
    )


def _derenderer(settings: TrainConfig, run: Run) -> TrainedDerenderer:
    """The de-renderer that `derenderer` names, or the one among the runs beside this one that knows the data."""
    counts = settings.split.counts(None)
    if settings.derenderer is not None:
        derenderer = TrainedDerenderer(Path(settings.derenderer))
    elif run.root is not None:
        derenderer = find_derenderer(run.root, run.scenario, set(counts), run.split)
    else:
        raise CophyError(f"positions={settings.positions}: name the checkpoint of a de-renderer with derenderer=")
    derenderer.check(experiments_of(settings, None))
    return derenderer


def _carry_out_oracle(settings: TrainConfig, oracle: OracleConfig, claim: Claim, started: float) -> None:
    for key, given in (("ckpt", settings.ckpt), ("predictor", settings.predictor)):
        if given is not None:
            raise CophyError(f"{key}={given}: {claim.run.model} has nothing to train or to restore")
    if settings.trainer.fast_dev_run:
        raise CophyError("trainer.fast_dev_run: an oracle takes no training step to try")
    if settings.positions != "ground_truth":
        raise CophyError(f"positions={settings.positions}: oracles simulate, from true positions only")
    data = _experiments(settings, claim.run, DeclaredInputs())
    data.prepare_data()
    data.setup()
    carry_out_oracle(claim, data, oracle.oracle, oracle.settings, loggers=settings.logger, started=started)
