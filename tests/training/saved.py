"""Checkpoints as train.py saves them, except for what a test changes."""

import copy
import functools
from pathlib import Path
from typing import Any

import torch

from cophy.config import composed, to_plain
from cophy.training.checkpoints import build_network, make_origin

# changes of the origin of any checkpoint, and what the error says
NONSENSE: list[tuple[dict[str, Any], str]] = [
    ({"scenario": "balls"}, "scenario is of type str"),
    ({"model": {}}, "model._target_ is not a name"),
    ({"more": 1}, "key more is missing or unknown"),
    ({"trained_on": None}, "trained_on is of type NoneType"),
    ({"size": {"name": torch.ones(3)}}, "Tensor is not a type"),
    ({"trainer": {1: 2}}, "a key is not a name"),
]


@functools.cache
def plain_settings(*overrides: str) -> dict[str, Any]:
    """Return the plain values of a training on balls, composed once per process; do not change them."""
    return to_plain(composed("train", "scenario=balls", *overrides))


def saved(path: Path, model: dict[str, Any], weights: dict[Any, Any], /, **changes: Any) -> Path:
    """Write a checkpoint of this model."""
    origin = make_origin(plain_settings(), trained_on=[[]])
    network = {f"network.{key}": value for key, value in weights.items()}
    torch.save({"origin": origin | {"model": model} | changes, "state_dict": network}, path)
    return path


def model_of(*overrides: str) -> dict[str, Any]:
    """Return the keys of a model as conf/ has them."""
    return copy.deepcopy(plain_settings(*overrides)["model"])


def weights_of(model: dict[str, Any]) -> dict[str, Any]:
    """Return untrained weights."""
    return build_network(model).state_dict()
