"""Arguments of models that are out of range are refused by their names."""

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from torch import nn

from cophy.errors import CophyError
from cophy.models import Derenderer, FittedSpheres, Replay, Trees
from tests.models import networks
from tests.models.test_baselines import REPLAY
from tests.models.test_spheres import ARGUMENTS

MODELS: dict[str, Callable[..., nn.Module]] = {
    **{
        name: partial(networks.build, name)
        for name in ("alongside", "cophynet", "single_step", "gns", "transformer", "hypotheses", "npe")
    },
    "derenderer": lambda **key: Derenderer(
        **{"slots": ["red"], "resolution": 32, "width": 4, "readout": "linear"} | key
    ),
    "replay": lambda **key: Replay(**REPLAY | key),
    "fitted_spheres": lambda **key: FittedSpheres(**ARGUMENTS | key),
    "trees": lambda **key: Trees(**{"num_trees": 1, "min_samples_leaf": 1} | key),
}
REFUSED: dict[str, list[tuple[str, Any, str]]] = {  # key, value, and the rest of the message, or a part of it
    "alongside": [
        ("edge_layers", 0, "must be at least 2"),
        ("hidden_dim", 0, "must be at least 1"),
        ("temperature", 0.0, "must be positive"),
        ("max_step", -1.0, "must be positive"),
        ("arena_half_width", 0.0, "must be positive"),
    ],
    "cophynet": [
        ("edge_layers", 1, "must be at least 2"),
        ("node_layers", 0, "must be at least 2"),
        ("hidden_dim", 0, "must be at least 1"),
        ("gru_layers", 0, "must be at least 1"),
        ("temperature", -1.0, "must be positive"),
        ("temperature", float("nan"), "must be positive"),
        ("gating", "often", "must be one of per_step, static"),
        ("confounders", "guessed", "must be one of estimated, ground_truth, without_pose, none"),
        ("interaction", "mlp", "needs model.slots"),
        ("decoding", "single_step", "needs model.num_frames"),
    ],
    "single_step": [("gating", "static", "model.gating has no effect with model.decoding=single_step")],
    "gns": [
        ("hidden_dim", 0, "must be at least 1"),
        ("message_steps", 0, "must be at least 1"),
        ("num_velocities", 0, "must be at least 1"),
        ("estimate_dim", 0, "must be at least 1"),
        ("gru_layers", 0, "must be at least 1"),
        ("edge_layers", 1, "must be at least 2"),
        ("node_layers", 1, "must be at least 2"),
        ("max_step", 0.0, "must be positive"),
        ("arena_half_width", -1.0, "must be positive"),
    ],
    "transformer": [
        ("hidden_dim", 0, "must be a multiple of 6, twice model.num_heads"),
        ("hidden_dim", 27, "must be a multiple of 6, twice model.num_heads"),
        ("num_heads", 0, "must be at least 1"),
        ("num_layers", 0, "must be at least 1"),
    ],
    "hypotheses": [
        ("hidden_dim", 0, "must be at least 1"),
        ("num_frames", 1, "must be at least 2"),
        ("block_size", 0.0, "must be positive"),
        ("block_size", None, "model=hypotheses predicts towers"),
    ],
    "npe": [
        ("edge_layers", 1, "must be at least 2"),
        ("node_layers", 0, "must be at least 1"),
        ("hidden_dim", 0, "must be at least 1"),
        ("radius", 0.0, "must be positive"),
        ("confounders", "estimated", "must be one of ground_truth"),
    ],
    "derenderer": [
        ("resolution", 30, "must be a multiple of 4"),
        ("resolution", 4, "must be a multiple of 4 and at least 8"),
        ("width", 0, "must be at least 1"),
        ("readout", "pooling", "must be one of attention, linear"),
        ("slots", [], "model.slots is empty"),
    ],
    "replay": [
        ("diameter", None, "use scenario=collision"),
        ("diameter", 0.0, "must be positive"),
        ("kept_speed", 0.0, "must be positive"),
        ("shrinkage", 0.0, "must be positive"),
    ],
    "fitted_spheres": [
        ("diameter", None, "use scenario=balls"),
        ("arena_half_width", None, "use scenario=balls"),
        ("restitution", [0.0, 1.0], "use confounders=text"),
        ("draws", 0, "must be at least 1"),
        ("error", 0.0, "must be positive"),
    ],
    "trees": [
        ("num_trees", 0, "must be at least 1"),
        ("min_samples_leaf", 0, "must be at least 1"),
        ("confounders", "estimated", "must be one of ground_truth"),
        ("confounders", "without_pose", "model.confounders=without_pose: statics needs the yaw"),
    ],
}


@pytest.mark.parametrize(
    ("model", "key", "value", "message"), [(model, *case) for model, cases in REFUSED.items() for case in cases]
)
def test_arguments_out_of_range_are_refused(model: str, key: str, value: object, message: str) -> None:
    start = f"model.{key}={value} " if message.startswith(("must", "needs")) else ""
    with pytest.raises(CophyError, match=re.escape(start + message)):
        MODELS[model](**{key: value})
