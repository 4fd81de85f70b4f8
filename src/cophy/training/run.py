"""One row of a table: data, network, training, test, metrics.json."""

import json
import logging
import pickle
import time
import warnings
from dataclasses import dataclass
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
from cophy.dataset.store import write_atomically
from cophy.errors import CophyError
from cophy.training.prediction import PredictionModule

log = logging.getLogger(__name__)

# the whole data set lies in memory and is sliced: Lightning's advice to add workers does not apply
warnings.filterwarnings("ignore", ".*does not have many workers.*")
warnings.filterwarnings("ignore", ".*LeafSpec.*")  # of Lightning 2.6 with torch 2.13, nothing a user can do


@dataclass(frozen=True)
class Row:
    """Where a run belongs: the names under which it was chosen, and its directory."""

    scenario: str
    split: str
    model: str
    ablation: str
    positions: str
    seed: int
    size: str
    directory: Path

    def names(self) -> dict[str, Any]:
        """The names alone."""
        return {key: value for key, value in vars(self).items() if key != "directory"}


def run_row(settings: TrainConfig, row: Row, resolved: dict[str, Any]) -> dict[str, float]:
    """Train (if there is anything to train), test the best checkpoint, write metrics.json; returns the metrics.

    resolved: the configuration as plain values; it goes into every checkpoint.
    """
    start = time.monotonic()
    (row.directory / "metrics.json").unlink(missing_ok=True)  # a stopped run must not pass for the one before it
    torch.set_num_threads(settings.threads)
    L.seed_everything(settings.seed, workers=True, verbose=False)
    data = CounterfactualDataModule(
        scenario=settings.scenario,
        split=settings.split,
        size=settings.size,
        seed=settings.data_seed,
        data_dir=Path(settings.data_dir),
        batch_size=settings.training.batch_size,
        workers=settings.workers,
    )
    network = build_network(resolved["model"])
    module = PredictionModule(
        network, settings.training, metric_dims=settings.scenario.task.metric_dims, config=resolved
    )
    trainer = _trainer(settings, row.directory)
    assert isinstance(trainer.logger, TensorBoardLogger)
    compared = row.names() | _flatten({part: resolved[part] for part in ("model", "training", "trainer")})
    trainer.logger.log_hyperparams(compared, {"test/mse": float("nan")})
    checkpoint = None
    if module.learns:
        trainer.fit(module, data, ckpt_path=_resumable(settings.ckpt, resolved), weights_only=True)
        checkpoint = None if settings.trainer.fast_dev_run else "best"
    elif settings.ckpt is not None:
        raise CophyError(f"ckpt={settings.ckpt}: {row.model} has nothing to train or to restore")
    results = trainer.test(module, data, ckpt_path=checkpoint, weights_only=True, verbose=False)[0]
    metrics = {name.removeprefix("test/"): value for name, value in results.items()}
    if not settings.trainer.fast_dev_run:
        _write_metrics(row, data, metrics, wall_seconds=time.monotonic() - start)
    return metrics


def build_network(model: dict[str, Any]) -> nn.Module:
    """The network that `model._target_` names, built from the remaining keys; anything but a torch module is refused."""
    arguments = {key: value for key, value in model.items() if key != "_target_"}
    try:
        kind = get_class(model["_target_"])
    except Exception as error:
        raise CophyError(f"model._target_={model['_target_']} cannot be imported: {error}") from error
    if not issubclass(kind, nn.Module):
        raise CophyError(f"model._target_={model['_target_']} is not a torch.nn.Module")
    try:
        return kind(**arguments)
    except TypeError as error:
        raise CophyError(f"model: {error}; see {model['_target_']}") from error


def _trainer(settings: TrainConfig, directory: Path) -> L.Trainer:
    checkpoints = ModelCheckpoint(
        directory / "checkpoints",
        filename="best",
        monitor="val/mse",
        save_last=True,
        enable_version_counter=False,
    )
    logger = TensorBoardLogger(directory, name="tensorboard", version="", default_hp_metric=False)
    callbacks = [checkpoints, LearningRateMonitor("epoch"), ResumeHint(directory / "checkpoints" / "last.ckpt")]
    return L.Trainer(logger=logger, callbacks=callbacks, default_root_dir=directory, **vars(settings.trainer))


class ResumeHint(L.Callback):
    """Say how to go on when training stops early."""

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        if self.checkpoint.exists():
            log.warning("stopped in epoch %d: go on with ckpt=%s", trainer.current_epoch, self.checkpoint)
        else:
            log.warning("stopped in epoch %d, before the first checkpoint", trainer.current_epoch)


def _resumable(ckpt: str | None, resolved: dict[str, Any]) -> str | None:
    """The checkpoint to go on from, if it is one and of this model; reading it runs no code (weights_only)."""
    if ckpt is None:
        return None
    if not Path(ckpt).is_file():
        raise CophyError(f"ckpt={ckpt} is no file")
    try:
        model = torch.load(ckpt, map_location="cpu", weights_only=True)["config"]["model"]
    except (pickle.UnpicklingError, RuntimeError, KeyError, TypeError, EOFError) as error:
        raise CophyError(f"ckpt={ckpt} is no checkpoint of train.py, or a damaged one") from error
    differing = {key for key in model.keys() | resolved["model"].keys() if model.get(key) != resolved["model"].get(key)}
    if differing:
        keys = ", ".join(f"model.{key}={model.get(key)}" for key in sorted(differing))
        raise CophyError(f"ckpt={ckpt} is of another model ({keys}): train it with the same, or another one anew")
    return ckpt


def _flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Leaves of nested dictionaries under dotted names, for TensorBoard's hparams."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= _flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return leaves


def _write_metrics(row: Row, data: CounterfactualDataModule, metrics: dict[str, float], *, wall_seconds: float) -> None:
    """metrics.json, once and whole: the row's names, the data behind it, and the test metrics."""
    content = {
        **row.names(),
        "dataset_ids": data.dataset_ids,
        "num_train": len(data.train),
        "num_test": len(data.test),
        "wall_seconds": round(wall_seconds, 1),
        "metrics": metrics,
    }
    path = row.directory / "metrics.json"
    write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())
    log.info("%s: %s", path, "  ".join(f"{name} {value:.4f}" for name, value in metrics.items()))
