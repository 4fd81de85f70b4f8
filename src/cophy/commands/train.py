"""Train and test one model on one split: python src/train.py scenario=balls model=cophynet"""

import logging
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from cophy import cli
from cophy.config import experiments_of, to_config, to_plain, variant
from cophy.dataset.source import GENERATED
from cophy.errors import CophyError
from cophy.schemas import ESTIMATED, TrainConfig, register
from cophy.training.run import Run, is_first

if TYPE_CHECKING:  # --help must not import torch and Lightning, which takes seconds
    from lightning import Trainer
    from torch import nn

    from cophy.dataset.datamodules import CounterfactualDataModule
    from cophy.dataset.frames import FrameDataModule
    from cophy.training import DerenderingModule, PredictionModule
    from cophy.training.trained import TrainedDerenderer

log = logging.getLogger(__name__)
if not {"--help", "-h"} & set(sys.argv):  # the schemas of models import torch, which takes seconds
    register(models=True)


@cli.command("train")
def main(cfg: DictConfig) -> float:
    from cophy.report.run_summary import show_results

    run, plain, hydra_config = run_of(cfg), to_plain(cfg), HydraConfig.get()
    in_parallel = hydra_config.runtime.choices["hydra/launcher"] != "basic"
    if in_parallel:  # progress bars would overwrite each other
        plain["trainer"] |= {"enable_progress_bar": False, "enable_model_summary": False}
    try:
        with run.locked(tests_checkpoint=cfg.predictor is not None):
            config = to_config(cfg, TrainConfig)
            validation = train(config, plain, run)
    except Exception as error:
        if hydra_config.mode is RunMode.MULTIRUN:  # the sweep continues; Hydra names only the first failed run
            log.error("%s failed: %s", run.place, error, exc_info=not cli.is_user_error(error))
        raise
    if is_first() and not in_parallel and not config.trainer.fast_dev_run:
        show_results(run, cfg.scenario.task.metric_dims)
    if validation and cfg.optimized_metric not in validation:
        raise CophyError(f"optimized_metric={cfg.optimized_metric} is not among {', '.join(sorted(validation))}")
    return validation.get(cfg.optimized_metric, math.nan)


def run_of(cfg: DictConfig) -> Run:
    """Return the names and directory of the run that a configuration describes."""
    choices = HydraConfig.get().runtime.choices
    return Run(
        **{group: choices[group] for group in ("scenario", "split", "model", "ablation")},
        size=choices["size"] if choices["source"] == GENERATED else choices["source"],  # released data have one size
        positions=cfg.positions,
        seed=cfg.seed,
        variant=variant(cfg, HydraConfig.get()),
        directory=Path(HydraConfig.get().runtime.output_dir),
    )


def train(config: TrainConfig, plain: dict[str, Any], run: Run) -> dict[str, float]:
    """Train and test a model and write the results.

    Args:
        config: The resolved configuration.
        plain: The same as plain values.
        run: Names and directory.

    Returns:
        The validation metrics of the epoch whose weights were tested; empty after a trial (trainer.fast_dev_run) and for
        models without training.
    """
    import lightning as L
    import torch

    from cophy.atomic_files import sha256
    from cophy.training import reuse
    from cophy.training.checkpoints import build_network, check_resumable, check_trained, make_origin
    from cophy.training.trainer import finishing, log_results, make_trainer, start_processes

    start = time.monotonic()
    if not is_first():  # the first process writes the log
        logging.getLogger("cophy").setLevel(logging.WARNING)
    torch.set_num_threads(config.threads)
    L.seed_everything(config.seed, workers=True, verbose=False)

    network = build_network(plain["model"])
    module = make_module(network, config, run)
    data = make_datamodule(config, plain["model"], run, network)
    origin = make_origin(plain, data.trained_on, without=reuse.WITHOUT_EFFECT)
    arguments = plain["trainer"] | {"max_epochs": num_epochs(config, network)}
    figures = module.make_figures(config.figures_every_n_epochs)
    trainer = make_trainer(run, origin, figures, loggers=config.logger, arguments=arguments)
    if config.ckpt is not None:
        check_resumable(Path(config.ckpt), origin, network)
    if config.predictor is not None:
        check_trained(Path(config.predictor), origin, network)

    code = reuse.hash_code(module, data, network)
    with finishing(trainer.loggers):
        data.prepare_data()
        data.setup()
        start_processes(trainer, module)
        if not config.trainer.fast_dev_run:
            run.begin()
        facts, checkpoint = fit_or_reuse(trainer, module, data, run, origin, arguments, config, code)
        trainer.test(module, data, ckpt_path=checkpoint, weights_only=True, verbose=False)
        if config.trainer.fast_dev_run:
            return {}
        if is_first():
            results = module.results(data)
            facts |= {
                "dataset_ids": data.dataset_ids,
                "derenderer": derenderer.name if (derenderer := getattr(data, "derenderer", None)) else None,
                "predictor": None if config.predictor is None else sha256(Path(config.predictor))[:8],
                "num_train": len(data.train),
                "num_test": len(results.pairs),
                "max_epochs": arguments["max_epochs"],
                "wall_seconds": round(time.monotonic() - start, 1),
            }
            log_results(trainer, run.write_results(results, facts))
    return facts["validation"]


def fit_or_reuse(
    trainer: "Trainer",
    module: "PredictionModule | DerenderingModule",
    data: "CounterfactualDataModule | FrameDataModule",
    run: Run,
    origin: dict[str, Any],
    arguments: dict[str, Any],
    config: TrainConfig,
    code: str,
) -> tuple[dict[str, Any], Path | None]:
    """Train, or use the checkpoint of an identical finished training or of predictor=.

    Returns:
        Facts for metrics.json (training_seconds, resumed, validation), and the checkpoint to test, None for the weights as
        they are.
    """
    from cophy.training import reuse
    from cophy.training.trainer import decide_first, fit, log_names, remove_earlier_curves, select_loggers, was_requeued

    ckpt, predictor = (None if name is None else Path(name) for name in (config.ckpt, config.predictor))
    is_trial, facts = config.trainer.fast_dev_run, {"training_seconds": 0.0, "resumed": 0, "validation": {}}
    wanted = reuse.fingerprint(
        origin,
        trainer=arguments,
        threads=config.threads,
        code=code,
        checksums=training_checksums(data),
        resumed_from=ckpt,
    )
    if predictor is not None or not is_trainable(module.network):
        start = reuse.Start(facts, predictor, 0)
    elif is_trial:
        start = reuse.Start(None, ckpt, 0)
    else:
        find = config.reuse or was_requeued()
        start = decide_first(trainer, lambda: reuse.start_training(run, wanted, reuse=find, ckpt=ckpt))

    if start.finished is None:
        if not start.resumed:
            remove_earlier_curves(trainer)
        log_names(trainer, run, origin, arguments)
        facts = fit(trainer, module, data, start.checkpoint) | {"resumed": start.resumed}
        if is_trial:
            return facts, None
        if is_first():
            reuse.record_finished(run, wanted, facts)
        return facts, run.checkpoints / "best.ckpt"

    if start.checkpoint is None or start.checkpoint.parent.resolve() != run.checkpoints.resolve():
        remove_earlier_curves(trainer)
    select_loggers(trainer)
    log_names(trainer, run, origin, arguments)
    validation = trainer.validate(module, data, ckpt_path=start.checkpoint, weights_only=True, verbose=False)
    if predictor is not None:
        facts["validation"] = {name: value for metrics in validation for name, value in metrics.items()}
    return facts | start.finished, start.checkpoint


def make_module(network: "nn.Module", config: TrainConfig, run: Run) -> "PredictionModule | DerenderingModule":
    """Wrap a network in the Lightning module that trains and tests it; an oracle names its own."""
    from cophy.models.derenderer import Derenderer
    from cophy.training import DerenderingModule, PredictionModule

    if not is_trainable(network):
        for key, value in (("ckpt", config.ckpt), ("predictor", config.predictor)):
            if value is not None:
                raise CophyError(f"{key}={value}: {run.model} has nothing to train or to restore")
        if config.trainer.fast_dev_run:
            raise CophyError(f"trainer.fast_dev_run: {run.model} has nothing to train")
    if isinstance(network, Derenderer):
        if config.predictor is not None:
            raise CophyError(f"predictor={config.predictor}: {run.model} predicts nothing")
        return DerenderingModule(network, config.training)
    module_class = getattr(network, "module_class", PredictionModule)
    return module_class(network, config.training, config.scenario, seed=config.seed)


def is_trainable(network: "nn.Module") -> bool:
    """Return whether a network has parameters to train."""
    return any(parameter.requires_grad for parameter in network.parameters())


def num_epochs(config: TrainConfig, network: "nn.Module") -> int:
    """Return the epochs of the training: some splits train predictors on half of the data for twice as many."""
    from cophy.models.derenderer import Derenderer

    factor = 1 if isinstance(network, Derenderer) else config.split.epochs_factor
    return max(factor * config.trainer.max_epochs, -1)  # -1 is no limit


def make_datamodule(
    config: TrainConfig, model: dict[str, Any], run: Run, network: "nn.Module"
) -> "CounterfactualDataModule | FrameDataModule":
    """Return the datamodule of a network; nothing is generated or read yet, except the checkpoint of a de-renderer."""
    from cophy.dataset.datamodules import CounterfactualDataModule
    from cophy.dataset.features import DeclaredInputs
    from cophy.dataset.frames import FrameDataModule
    from cophy.models.derenderer import Derenderer

    if isinstance(network, Derenderer):
        if "rgb" not in config.render.modalities:
            raise CophyError("a de-renderer needs RGB images: use render=rgb or render=all")
        return FrameDataModule(
            experiments_of(config, config.num_objects),
            render=config.render,
            resolution=network.resolution,
            num_images=config.num_images,
            data_seed=config.data_seed,
            batch_size=config.training.batch_size,
            workers=config.workers,
            seed=config.seed,
        )
    declared, estimated = DeclaredInputs.of(model), ESTIMATED[config.positions]
    learns_confounders = config.training.confounder_weight > 0
    if learns_confounders and "train" in estimated:
        raise CophyError(
            f"positions={config.positions} does not go with training.confounder_weight: true confounders belong to true "
            "objects"
        )
    if estimated and declared.not_derendered:
        raise CophyError(
            f"positions={config.positions} does not go with {declared.not_derendered}: no de-renderer estimates it"
        )
    if estimated and getattr(network, "needs_true_positions", False):
        raise CophyError(f"positions={config.positions}: oracles simulate, from true positions only")
    train_set, test_set = (
        experiments_of(config, [part.num_objects])[0] for part in (config.split.train, config.split.test)
    )
    return CounterfactualDataModule(
        config.split,
        train_set=train_set,
        test_set=test_set,
        batch_size=config.training.batch_size,
        workers=config.workers,
        seed=config.seed,
        derenderer=find_derenderer_of(config, run) if estimated else None,
        estimated=estimated,
        declared=declared,
        needs_confounders=declared.confounders or learns_confounders,
        num_experiments=config.training.num_experiments,
    )


def find_derenderer_of(config: TrainConfig, run: Run) -> "TrainedDerenderer":
    """Return the de-renderer that `derenderer` names, or the one among the runs that was trained on these data."""
    from cophy.training.trained import TrainedDerenderer, find_derenderer

    if config.derenderer is not None:
        derenderer = TrainedDerenderer(Path(config.derenderer))
    elif run.root is not None:
        derenderer = find_derenderer(run.root, run.scenario, set(config.split.counts(None)), run.split)
    else:
        raise CophyError(f"positions={config.positions}: name the checkpoint of a de-renderer with derenderer=")
    derenderer.check(experiments_of(config, None))
    return derenderer


def training_checksums(data: "CounterfactualDataModule | FrameDataModule") -> dict[str, Any]:
    """Return the checksums of the shards that training reads."""
    from cophy.dataset.datamodules import CounterfactualDataModule

    if isinstance(data, CounterfactualDataModule):
        return {data.train_set.id: data.train_set.checksums()}
    states = {experiments.id: experiments.checksums() for experiments in data.sets}
    return states | {images.name: images.checksums() for images, _ in data.train.sources}
