"""One row of a table: data, network, training, test, results."""

import logging
import time
import warnings
from pathlib import Path
from typing import Any

import lightning as L
import torch
from hydra.utils import get_class
from lightning.pytorch.callbacks import LearningRateMonitor, ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from torch import nn

from cophy.config import TrainConfig
from cophy.dataset.datamodule import CounterfactualDataModule
from cophy.dataset.frames import FrameDataModule
from cophy.errors import CophyError
from cophy.training import reuse
from cophy.training.callbacks import ResumeHint
from cophy.training.checkpoints import read_checkpoint
from cophy.training.derendering import DerenderingModule
from cophy.training.prediction import PredictionModule
from cophy.training.row import Row
from cophy.training.stages import stage

log = logging.getLogger(__name__)

# the whole data set lies in memory and is sliced: Lightning's advice to add workers does not apply
warnings.filterwarnings("ignore", ".*does not have many workers.*")
warnings.filterwarnings("ignore", ".*LeafSpec.*")  # of Lightning 2.6 with torch 2.13, nothing a user can do


def run_row(settings: TrainConfig, row: Row, resolved: dict[str, Any]) -> dict[str, float]:
    """Train (if there is anything to train), test the best checkpoint, write the results; returns the metrics.

    resolved: the configuration as plain values; it goes into every checkpoint.
    """
    start = time.monotonic()
    torch.set_num_threads(settings.threads)
    L.seed_everything(settings.seed, workers=True, verbose=False)
    network = build_network(resolved["model"])
    chosen = stage(network, settings, row, resolved)
    data, module = chosen.data, chosen.module
    resolved["trained_on"] = data.training_depends_on  # into the checkpoints, with the rest
    trainer = _trainer(settings, row.directory, chosen.figures)
    assert trainer.logger is not None  # TensorBoard, or of a fast_dev_run one that does nothing
    compared = row.names() | _flatten({part: resolved[part] for part in ("model", "training", "trainer")})
    trainer.logger.log_hyperparams(compared, {"test/mse": float("nan")})
    checkpoint, training_seconds = None, 0.0
    if module.learns:
        training_seconds = _train(module, data, trainer, settings, row, resolved)
        checkpoint = None if settings.trainer.fast_dev_run else row.directory / "checkpoints" / "best.ckpt"
    elif settings.ckpt is not None:
        raise CophyError(f"ckpt={settings.ckpt}: {row.model} has nothing to train or to restore")
    trainer.test(module, data, ckpt_path=checkpoint, weights_only=True, verbose=False)
    if settings.trainer.fast_dev_run:
        return {}
    values, pairs = chosen.results()
    about = {
        "dataset_ids": data.dataset_ids,
        "derenderer": chosen.derenderer,
        "num_train": len(data.train),
        "num_test": len(data.test),
        "training_seconds": training_seconds,
        "wall_seconds": round(time.monotonic() - start, 1),
    }
    metrics = row.finish(values, pairs, about)
    trainer.logger.log_metrics({f"test/{name}": value for name, value in metrics.items()}, trainer.global_step)
    trainer.logger.save()
    return metrics


def build_network(model: dict[str, Any]) -> nn.Module:
    """The network that `model._target_` names, built from the remaining keys; anything but a torch module is refused."""
    arguments = {key: value for key, value in model.items() if key != "_target_"}
    if "_target_" not in model:
        raise CophyError("model._target_ is missing: it names the class of the model")
    try:
        kind = get_class(model["_target_"])
    except Exception as error:
        package = str(model["_target_"]).split(".")[0]
        unknown = isinstance(cause := error.__cause__, ModuleNotFoundError) and cause.name == package
        why = f"no module {package} (is its folder on PYTHONPATH?)" if unknown else " ".join(str(error).split())
        raise CophyError(f"model._target_={model['_target_']} cannot be imported: {why}") from error
    if not issubclass(kind, nn.Module):
        raise CophyError(f"model._target_={model['_target_']} is not a torch.nn.Module")
    try:
        return kind(**arguments)
    except TypeError as error:
        raise CophyError(f"model: {error}; see {model['_target_']}") from error


def _train(
    module: PredictionModule | DerenderingModule,
    data: CounterfactualDataModule | FrameDataModule,
    trainer: L.Trainer,
    settings: TrainConfig,
    row: Row,
    resolved: dict[str, Any],
) -> float:
    """Fit, or adopt the checkpoints of a training that was the same; returns the seconds that training took."""
    resume = _resumable(settings.ckpt, resolved)
    print_of_training = reuse.fingerprint(data, module.network, resolved)
    found = (
        reuse.find(row, print_of_training) if settings.reuse and not (resume or settings.trainer.fast_dev_run) else None
    )
    if found is not None:
        log.info("trained already, on the same data with the same settings: %s (reuse=false trains again)", found)
        return reuse.adopt(found, row)
    if resume is None:
        reuse.forget(row)
    data.prepare_data()  # Lightning would do so in fit, but to generate is no cost of the row
    start = time.monotonic()
    trainer.fit(module, data, ckpt_path=resume, weights_only=True)
    seconds = time.monotonic() - start
    if resume is None and not settings.trainer.fast_dev_run:
        reuse.record(row, print_of_training, training_seconds=seconds)
    return round(seconds, 1)


def _trainer(settings: TrainConfig, directory: Path, figures: L.Callback) -> L.Trainer:
    checkpoints = directory / "checkpoints"
    logger = TensorBoardLogger(directory, name="tensorboard", version="", default_hp_metric=False)
    callbacks = [
        ModelCheckpoint(checkpoints, filename="best", monitor="val/mse", enable_version_counter=False),
        # apart from the best: with save_last=True Lightning 2.6 writes the last one only when it is the best
        ModelCheckpoint(checkpoints, filename="last", enable_version_counter=False),
        LearningRateMonitor("epoch"),
        figures,
        ResumeHint(checkpoints / "last.ckpt"),
    ]
    return L.Trainer(logger=logger, callbacks=callbacks, default_root_dir=directory, **vars(settings.trainer))


def _resumable(ckpt: str | None, resolved: dict[str, Any]) -> str | None:
    """The checkpoint to go on from, if it is one and of this model; reading it runs no code (weights_only)."""
    if ckpt is None:
        return None
    if not Path(ckpt).is_file():
        raise CophyError(f"ckpt={ckpt} is no file")
    trained = _weights_depend_on(read_checkpoint(Path(ckpt).read_bytes(), Path(ckpt))["config"])
    wanted = _weights_depend_on(resolved)
    differing = [key for key in sorted(trained.keys() | wanted.keys()) if trained.get(key) != wanted.get(key)]
    if differing:
        keys = ", ".join(f"{key}={trained.get(key)}" for key in differing)
        raise CophyError(f"ckpt={ckpt} is of another training ({keys}): go on with the same settings, or start anew")
    return ckpt


def _weights_depend_on(config: dict[str, Any]) -> dict[str, Any]:
    """The keys that a resumed training must share with the one it goes on from; it may be longer."""
    parts = {"scenario": config["scenario"], "split.train": config["split"]["train"]}
    parts |= {key: config[key] for key in ("model", "training", "data_seed", "size")}
    keys = _flatten(parts | {"data": config.get("trained_on")})
    return {key: value for key, value in keys.items() if key != "scenario.task.splits"}  # names, no data


def _flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Leaves of nested dictionaries under dotted names, for TensorBoard's hparams."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= _flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return leaves
