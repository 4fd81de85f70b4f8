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
from cophy.atomic_files import sha256
from cophy.config import changes, experiments_of, to_config, to_plain, value_text, variant
from cophy.dataset.source import GENERATED
from cophy.dataset.splits import Split
from cophy.errors import CophyError
from cophy.schemas import ESTIMATED, TrainConfig, register
from cophy.training.run import TESTED_CHECKPOINT, Run, is_rank_zero

if TYPE_CHECKING:  # --help must not import torch and Lightning, which takes seconds
    from lightning import Trainer
    from torch import nn

    from cophy.dataset.datamodules import CounterfactualDataModule
    from cophy.dataset.frames import FrameDataModule
    from cophy.training import DerenderingModule, PredictionModule
    from cophy.training.reuse import Start
    from cophy.training.trained import TrainedDerenderer

log = logging.getLogger(__name__)
if not {"--help", "-h"} & set(sys.argv):  # the schemas of models import torch, which takes seconds
    register(models=True)


@cli.command("train")
def main(cfg: DictConfig) -> float:
    hydra_config = HydraConfig.get()
    if hydra_config.mode is RunMode.RUN:  # at once; in a sweep the run also leaves failure.json, which takes seconds
        scenario: Any = to_config(cfg.scenario, object)
        to_config(cfg.split, Split).check_scenario(scenario)
    run, plain = make_run(cfg), to_plain(cfg)
    in_parallel = hydra_config.runtime.choices["hydra/launcher"] != "basic"
    if in_parallel:  # progress bars would overwrite each other
        plain["trainer"] |= {"enable_progress_bar": False, "enable_model_summary": False}
    try:
        with run.locked(tests=None if cfg.predictor is None else TESTED_CHECKPOINT):
            config = to_config(cfg, TrainConfig)  # inside the lock, so that an invalid value also leaves failure.json
            validation = train(config, plain, run)
    except Exception as error:
        if hydra_config.mode is RunMode.MULTIRUN:  # the sweep continues; Hydra names only the first failed run
            log.error("%s failed: %s", run.place, error, exc_info=not cli.is_user_error(error))
        raise
    if is_rank_zero() and not in_parallel and not config.trainer.fast_dev_run:
        from cophy.report.run_summary import show_results

        show_results(run, [*config.metrics])
    if validation:  # of a training that is reused
        from cophy.training.callbacks import check_optimized

        check_optimized(cfg.optimized_metric, validation)
    return validation.get(cfg.optimized_metric, math.nan)


def make_run(cfg: DictConfig) -> Run:
    """Return the names and directory of the run that a configuration describes."""
    choices, changed = HydraConfig.get().runtime.choices, changes(cfg, HydraConfig.get())
    return Run(
        **{group: choices[group] for group in ("scenario", "split", "model", "ablation")},
        size=choices["size"] if choices["source"] == GENERATED else choices["source"],  # released data have one size
        positions=cfg.positions,
        seed=cfg.seed,
        variant=variant(changed),
        directory=Path(HydraConfig.get().runtime.output_dir),
        changes={key: value_text(value) for key, value in changed.items()},
    )


def train(config: TrainConfig, plain: dict[str, Any], run: Run) -> dict[str, float]:
    """Train and test a model and write the results.

    Args:
        config: The resolved configuration.
        plain: The same configuration as nested dicts; its `trainer` holds the arguments of `lightning.Trainer`.

    Returns:
        Validation metrics of the tested model; empty with trainer.fast_dev_run and for oracles.
    """
    import lightning as L
    import torch

    from cophy.dataset.features import declared_inputs
    from cophy.models.derenderer import Derenderer
    from cophy.training.checkpoints import build_network, make_origin
    from cophy.training.instantiation import instantiate_key
    from cophy.training.reuse import fingerprint, hash_code, record_finished
    from cophy.training.trainer import (
        check_devices,
        finishing,
        fit,
        log_results,
        make_trainer,
        prepare_loggers,
        reporting,
        start_processes,
    )

    start_time = time.monotonic()
    if not is_rank_zero():  # the first process writes the log
        logging.getLogger("cophy").setLevel(logging.WARNING)
    torch.set_num_threads(config.threads)
    L.seed_everything(config.seed, workers=True, verbose=False)

    network = build_network(plain["model"])
    if isinstance(network, Derenderer) != run.model.startswith("derenderer"):
        raise CophyError(f"model={run.model}: the names of de-renderers, and no others, begin with derenderer")
    module = make_module(network, config)
    data = make_datamodule(config, plain["model"], run, network)
    origin = make_origin(plain, data.trained_on)
    check_checkpoints(config, origin, network, run.model)
    if config.trainer.precision in ("16", "16-mixed") and getattr(network, "limits_gradients", False):
        raise CophyError(
            f"trainer.precision={config.trainer.precision}: model={run.model} needs unscaled losses, use bf16-mixed"
        )
    arguments = plain["trainer"] | {"max_epochs": num_epochs(config, network)}
    figures = module.make_figures(config.figures_every_n_epochs)
    trainer = make_trainer(
        run, origin, figures, loggers=config.logger, arguments=arguments, optimized_metric=config.optimized_metric
    )
    check_devices(trainer, module)
    optimisation = [
        instantiate_key(f"{key}=", getattr(config.training, key), _partial_=True) for key in ("optimizer", "schedule")
    ]
    code = hash_code(network, getattr(module, "position_loss", None), *trainer.callbacks, *optimisation)  # type: ignore[attr-defined]

    with finishing(trainer.loggers):
        data.prepare_data()
        data.setup()
        start_processes(trainer)
        training_hash = fingerprint(
            origin,
            max_epochs=arguments["max_epochs"],
            threads=config.threads,
            code=code,
            checksums=data.training_checksums(),
            resumed_from=path_of(config.ckpt),
        )
        if not config.trainer.fast_dev_run:
            run.delete_earlier_results()
        start = find_start(config, run, (training_hash, code), trainer, network)
        prepare_loggers(trainer, run, origin, arguments, start)

        if start.finished is None:
            facts = fit(trainer, module, data, start.checkpoint) | {"resumed": start.resumed}
            tested = None if config.trainer.fast_dev_run else run.checkpoints / "best.ckpt"
            if tested is not None and not tested.is_file():
                raise CophyError(
                    "the training ended before its first validation: raise trainer.max_time= or trainer.max_epochs=, or lower "
                    "trainer.check_val_every_n_epoch="
                )
            if tested is not None and is_rank_zero():
                record_finished(run, training_hash, facts | {"code": code})
        else:
            facts, tested = start.finished, start.checkpoint
            # also draws the validation figures of a training that is not repeated
            with reporting(trainer, tested):
                validation = trainer.validate(module, data, ckpt_path=tested, weights_only=True, verbose=False)
            for values in validation:  # none without validation batches
                facts["validation"] = dict(values) | facts["validation"]  # metrics that are new are added
        with reporting(trainer, tested):
            trainer.test(module, data, ckpt_path=tested, weights_only=True, verbose=False)

        if config.trainer.fast_dev_run:
            return {}
        if is_rank_zero():
            results = module.results(data)
            derenderer, predictor = getattr(data, "derenderer", None), path_of(config.predictor)
            facts |= {
                "dataset_ids": data.dataset_ids,
                "inputs": declared_inputs(plain["model"]),
                "derenderer": derenderer.name if derenderer else None,
                "predictor": sha256(predictor)[:8] if predictor else None,
                "num_train": len(data.train),
                "num_test": len(results.clusters),
                "max_epochs": arguments["max_epochs"],
                "metric_dims": config.scenario.task.metric_dims,
                "parameters": sum(each.numel() for each in network.parameters() if each.requires_grad),
                "optimizer": config.training.optimizer["_target_"].rpartition(".")[2]
                if is_trainable(network)
                else None,
                "learning_rate": config.training.learning_rate if is_trainable(network) else 0.0,
                "wall_seconds": round(time.monotonic() - start_time, 1),
            }
            log_results(trainer, run.write_results(results, facts))
    return facts["validation"]


def find_start(
    config: TrainConfig, run: Run, hashes: tuple[str, str], trainer: "Trainer", network: "nn.Module"
) -> "Start":
    """Decide whether a run trains, resumes, or only tests.

    It only tests if the model has no parameters, predictor= is set, or the same training has finished.

    Args:
        hashes: Fingerprint of its training, and that of its code.
        trainer: Rank 0 decides for all processes.
    """
    from cophy.training.reuse import Start, start_training
    from cophy.training.trainer import decide_first, was_requeued

    if config.predictor is not None or not is_trainable(network):
        untrained = {"training_seconds": 0.0, "training_cpu_seconds": 0.0, "resumed": 0, "validation": {}}
        return Start(untrained, path_of(config.predictor))
    if config.trainer.fast_dev_run:
        return Start(None, path_of(config.ckpt), keeps_curves=True)
    wanted, code = hashes
    keys: dict[str, Any] = {"reuse": config.reuse or was_requeued(), "ckpt": path_of(config.ckpt), "code": code}
    return decide_first(trainer, lambda: start_training(run, wanted, **keys))


def check_checkpoints(config: TrainConfig, origin: dict[str, Any], network: "nn.Module", name: str) -> None:
    """Refuse a checkpoint given as ckpt= or predictor= that does not fit the model or its training."""
    from cophy.models.derenderer import Derenderer
    from cophy.training.checkpoints import check_resumable, check_trained

    ckpt, predictor = path_of(config.ckpt), path_of(config.predictor)
    values = {"ckpt": ckpt, "predictor": predictor, "trainer.fast_dev_run": config.trainer.fast_dev_run or None}
    for key, value in values.items():
        if value is not None and not is_trainable(network):
            raise CophyError(f"{key}={value}: {name} has nothing to train")
    if predictor is not None and isinstance(network, Derenderer):
        raise CophyError(f"predictor={predictor}: this is for predictors of D, and model={name} is a de-renderer")
    if ckpt is not None:
        check_resumable(ckpt, origin, network)
    if predictor is not None:
        check_trained(predictor, origin, network)


def path_of(value: str | None) -> Path | None:
    """Return the path that a key names, or None."""
    return None if value is None else Path(value)


def make_module(network: "nn.Module", config: TrainConfig) -> "PredictionModule | DerenderingModule":
    """Wrap a network in the Lightning module that trains and tests it: its `module_class`, if it has one, as oracles do."""
    from cophy.models.derenderer import Derenderer
    from cophy.training import DerenderingModule, PredictionModule
    from cophy.training.losses import MSE

    if isinstance(network, Derenderer):
        settings = config.training
        others = {
            "loss=": settings.loss != MSE,
            "metrics=": config.metrics,
            "positions=": config.positions != "ground_truth",
            "training.num_experiments=": settings.num_experiments,
            "training.position_noise=": settings.position_noise,
            "training.confounder_weight=": settings.confounder_weight,
        }
        if given := [key for key, value in others.items() if value]:
            raise CophyError(f"{given[0]} is for predictors of D, and this model is a de-renderer")
        return DerenderingModule(network, config.training)
    module_class = getattr(network, "module_class", PredictionModule)
    return module_class(network, config.training, config.scenario, seed=config.seed, metrics=config.metrics)


def is_trainable(network: "nn.Module") -> bool:
    """Return whether a network has parameters to train."""
    return any(parameter.requires_grad for parameter in network.parameters())


def num_epochs(config: TrainConfig, network: "nn.Module") -> int:
    """Return the epochs of the training; splits that train on half of the data take twice as many (`epochs_factor`)."""
    from cophy.models.derenderer import Derenderer

    factor = 1 if isinstance(network, Derenderer) else config.split.epochs_factor
    return max(factor * config.trainer.max_epochs, -1)  # -1 is no limit


def make_datamodule(
    config: TrainConfig, model: dict[str, Any], run: Run, network: "nn.Module"
) -> "CounterfactualDataModule | FrameDataModule":
    """Return the datamodule of a network; nothing is generated or read yet, except the checkpoint of a de-renderer."""
    from cophy.dataset.datamodules import CounterfactualDataModule
    from cophy.dataset.features import declared_inputs, not_derendered
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
    declared, estimated = declared_inputs(model), ESTIMATED[config.positions]
    learns_confounders = config.training.confounder_weight > 0
    if learns_confounders and "train" in estimated:
        raise CophyError(
            f"positions={config.positions} does not go with training.confounder_weight: true confounders cannot be "
            "matched to estimated objects; use positions=ground_truth"
        )
    if estimated and (keys := not_derendered(declared)):
        raise CophyError(f"positions={config.positions} does not go with {keys}: no de-renderer estimates it")
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
        derenderer=configured_derenderer(config, run) if estimated else None,
        estimated=estimated,
        declared=declared,
        needs_confounders="confounders" in declared or learns_confounders,
        num_experiments=config.training.num_experiments,
    )


def configured_derenderer(config: TrainConfig, run: Run) -> "TrainedDerenderer":
    """Return the de-renderer that `derenderer` names, or the one among the runs that was trained on these data."""
    from cophy.training.trained import TrainedDerenderer, find_derenderer

    sets = experiments_of(config, None)
    if config.derenderer is not None:
        derenderer = TrainedDerenderer(Path(config.derenderer))
    elif run.root is not None:
        derenderer = find_derenderer(run.root, sets, set(config.split.counts(None)), run.split)
    else:
        raise CophyError(f"positions={config.positions}: name the checkpoint of a de-renderer with derenderer=")
    derenderer.check(sets)
    return derenderer
