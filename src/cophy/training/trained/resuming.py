"""Whether a training may go on from a checkpoint: only with the settings that its weights came from."""

from pathlib import Path
from typing import Any

from cophy.errors import CophyError
from cophy.training.trained.checkpoints import Origin, read_bytes, read_checkpoint

NO_SETTING = {"scenario.task.splits"}  # names of splits: a split more changes no training


def check_resumable(ckpt: Path, origin: Origin) -> None:
    """Refuse a checkpoint of another training. The resumed one may be longer.

    Args:
        ckpt: The checkpoint to go on from; reading it runs no code.
        origin: What is to be trained.

    Raises:
        CophyError: It is no checkpoint, or of another training; the message names the keys that differ.
    """
    if not ckpt.is_file():
        raise CophyError(f"ckpt={ckpt} is no file: a run keeps last.ckpt in its checkpoints/")
    checkpoint = read_checkpoint(read_bytes(ckpt), ckpt)
    if not checkpoint.has_optimizer:
        raise CophyError(f"ckpt={ckpt} holds weights alone, for tests and predictions: go on from the run's last.ckpt")
    trained = _weights_depend_on(checkpoint.origin)
    wanted = _weights_depend_on(origin)
    if differing := [key for key in sorted(trained.keys() | wanted.keys()) if trained.get(key) != wanted.get(key)]:
        keys = ", ".join(f"{key}={trained.get(key)}" for key in differing)
        raise CophyError(f"ckpt={ckpt} is of another training ({keys}): go on with the same settings, or start anew")


def flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Leaves of nested dictionaries under dotted names."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return leaves


def _weights_depend_on(origin: Origin) -> dict[str, Any]:
    parts = {
        "scenario": origin.scenario,
        "split.train": origin.split["train"],
        "model": origin.model,
        "training": origin.training,
        "data_seed": origin.data_seed,
        "size": origin.size,
        "data": origin.trained_on,
    }
    return {key: value for key, value in flatten(parts).items() if key not in NO_SETTING}
