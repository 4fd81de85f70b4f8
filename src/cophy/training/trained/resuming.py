"""Whether a training may go on from a checkpoint, or be spared by one: only with the settings that its weights came from."""

from pathlib import Path
from typing import Any

from cophy.errors import CophyError
from cophy.training.trained.checkpoints import Checkpoint, Origin, made_from, read_bytes, read_checkpoint
from cophy.training.trained.network import check_shapes

NAMED = 3  # settings in a message
CHOSEN = ("scenario", "size")  # by a name, which brings all other keys below it
NO_SETTING = {"scenario.task.splits"}  # names of splits: a split more changes no training
MAY_CHANGE = {  # where a training goes on: how long it is, how it is validated, and whether it is a trial
    *("trainer.max_epochs", "trainer.max_time", "split.epochs_factor", "trainer.fast_dev_run"),
    *("trainer.limit_val_batches", "trainer.check_val_every_n_epoch"),
}


def check_resumable(ckpt: Path, origin: Origin) -> None:
    """Refuse a checkpoint of another training. The resumed one may be longer.

    Args:
        ckpt: The checkpoint to go on from; reading it runs no code.
        origin: What is to be trained.

    Raises:
        CophyError: It is no checkpoint, or of another training (the message names the keys that differ), or its weights do
            not fit.
    """
    checkpoint = _read(ckpt, "ckpt", "last.ckpt")
    if not checkpoint.has_optimizer:
        raise CophyError(f"ckpt={ckpt} holds weights alone, for tests and predictions: go on from the run's last.ckpt")
    says_all = checkpoint.origin.seed is not None  # as earlier versions did not
    depends_on = _all_weights_depend_on if says_all else _weights_depend_on
    own, wanted = depends_on(checkpoint.origin), depends_on(origin)
    if keys := _differing(*({key: each[key] for key in each.keys() - MAY_CHANGE} for each in (own, wanted))):
        raise CophyError(f"ckpt={ckpt} is of another training ({keys}): go on with the same settings, or start anew")
    _check_weights(ckpt, checkpoint)


def check_trained(predictor: Path, origin: Origin) -> None:
    """Refuse a checkpoint whose weights are not those that this training would end with.

    Args:
        predictor: The checkpoint to test instead of training; reading it runs no code.
        origin: What would be trained.

    Raises:
        CophyError: It is no checkpoint, too old to tell, or of another training (the message names the keys that differ), or
            its weights do not fit.
    """
    checkpoint = _read(predictor, "predictor", "best.ckpt")
    own = checkpoint.origin
    if own.seed is None:
        raise CophyError(
            f"predictor={predictor} does not say with which seed it was trained, as earlier versions did not"
        )
    if keys := _differing(_all_weights_depend_on(own), _all_weights_depend_on(origin)):
        raise CophyError(f"predictor={predictor} is of another training ({keys}): test it with the same settings")
    _check_weights(predictor, checkpoint)


def flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Leaves of nested dictionaries under dotted names."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return leaves


def _read(path: Path, key: str, kept: str) -> Checkpoint:
    if not path.is_file():
        raise CophyError(f"{key}={path} is no file: a run keeps {kept} in its checkpoints/")
    return read_checkpoint(read_bytes(path), path)


def _check_weights(source: Path, checkpoint: Checkpoint) -> None:
    """Refuse those that do not fit the class of the model as it is now; its arguments are the same."""
    with made_from(source):
        check_shapes(checkpoint.origin.model, checkpoint.weights)


def _differing(trained: dict[str, Any], wanted: dict[str, Any]) -> str:
    """The settings of a checkpoint that are not those wanted, as a command line has them; of many, the first."""
    keys = [key for key in sorted(trained.keys() | wanted.keys()) if trained.get(key) != wanted.get(key)]
    chosen = [group for group in CHOSEN if f"{group}.name" in keys]
    others = [key for key in keys if key.split(".")[0] not in (*chosen, "data")]
    if not chosen and not others:
        others = keys  # data alone, which else follow from the settings
    named = [f"{group}={trained[f'{group}.name']}" for group in chosen]
    named += [f"{key}={trained.get(key)}" for key in others]
    more = [f"and {len(named) - NAMED} others"] if len(named) > NAMED else []
    return ", ".join(named[:NAMED] + more)


def _all_weights_depend_on(origin: Origin) -> dict[str, Any]:
    """Also what earlier versions did not write down."""
    last = {"seed": origin.seed, "trainer": origin.trainer, "split.epochs_factor": origin.split.get("epochs_factor")}
    return _weights_depend_on(origin) | flatten(last)


def _weights_depend_on(origin: Origin) -> dict[str, Any]:
    parts = {
        "scenario": origin.scenario,
        "split.train": origin.split.get("train"),
        "model": origin.model,
        "training": origin.training,
        "data_seed": origin.data_seed,
        "size": origin.size,
        "data": origin.trained_on,
    }
    return {key: value for key, value in flatten(parts).items() if key not in NO_SETTING}
