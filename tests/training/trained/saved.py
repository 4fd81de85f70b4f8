"""Checkpoints as train.py saves them, but for what a test changes."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from cophy.config import composed, to_plain
from cophy.training.checkpoints import Origin, build_network

PARTS = ("training", "scenario", "split", "size", "data_seed", "positions", "num_objects", "render")
ITSELF: dict[str, Any] = {"name": "tiny", "num_experiments": 4}
ITSELF["inner"] = ITSELF
# (changes of the origin of any checkpoint, what is said of it)
NONSENSE = [
    ({"scenario": "balls"}, "balls is no dictionary"),
    ({"model": {}}, "a key is missing: '_target_'"),
    ({"more": 1}, "unexpected keyword argument 'more'"),
    ({"num_objects": 5}, "num_objects or trained_on is no list"),
    ({"trained_on": None}, "num_objects or trained_on is no list"),
    ({"data_seed": 10**400}, "a number of 1329 bits is too large"),
    ({"size": {"name": torch.ones(3)}}, "a Tensor is no value of a configuration"),
    ({"trainer": {1: 2}}, "a key of int is no name"),
    ({"size": ITSELF}, "nested more than 10 deep, or contain themselves"),
]


def saved(path: Path, model: dict[str, Any], weights: dict[Any, Any], /, **changes: Any) -> Path:
    """A checkpoint of this model."""
    plain = to_plain(composed("train", "scenario=balls"))
    origin = asdict(Origin(model, **{part: plain[part] for part in PARTS}, trained_on=[[]]))
    of_network = {f"network.{key}": value for key, value in weights.items()}
    torch.save({"origin": origin | changes, "state_dict": of_network}, path)
    return path


def model_of(*overrides: str) -> dict[str, Any]:
    """Its keys, as conf/ has them."""
    return to_plain(composed("train", "scenario=balls", *overrides))["model"]


def weights_of(model: dict[str, Any]) -> dict[str, Any]:
    """Weights that nobody trained."""
    return build_network(model).state_dict()
