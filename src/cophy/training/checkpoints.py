"""Checkpoints of train.py, read without running code from them."""

import io
import pickle
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cophy.errors import CophyError

KEYS = ("model", "scenario", "split", "size", "training", "positions", "data_seed")  # of every run's configuration


def read_checkpoint(content: bytes, source: Path) -> dict[str, Any]:
    """What train.py saved: `config`, plain values, and `state_dict`; anything else is refused."""
    try:
        checkpoint = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        sound = isinstance(checkpoint["config"], dict) and isinstance(checkpoint["state_dict"], dict)
        for key in KEYS:
            checkpoint["config"][key]
        checkpoint["config"]["model"]["_target_"], checkpoint["config"]["scenario"]["name"]
    except (pickle.UnpicklingError, RuntimeError, KeyError, TypeError, IndexError, EOFError, ValueError):
        sound = False
    if not sound:
        raise CophyError(f"{source} is no checkpoint of train.py, or a damaged one")
    return checkpoint


def weights_of(checkpoint: dict[str, Any]) -> dict[str, Tensor]:
    """Those of the network alone."""
    prefix = "network."
    return {
        key.removeprefix(prefix): value for key, value in checkpoint["state_dict"].items() if key.startswith(prefix)
    }
