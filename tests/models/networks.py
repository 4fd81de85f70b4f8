"""Small networks of every kind, and random experiments as their input."""

from dataclasses import fields, replace
from typing import Any

import torch
from torch import Tensor, nn

from cophy.models import (
    GNS,
    Alongside,
    CoPhyNet,
    CopyB,
    CopyC,
    DisplacedCopyB,
    Hypotheses,
    InteractionNetwork,
    Transformer,
)
from cophy.types import CONFOUNDERS, OBJECT_TYPES, POSE, SLOT_AXIS, Batch, Inputs, Prediction, Targets

NUM_FRAMES = 7
HIDDEN_DIM = 24  # unlike the width of any input, so that no two can be confused

COPHYNET = {
    "hidden_dim": HIDDEN_DIM,
    "gru_layers": 2,
    "edge_layers": 4,
    "node_layers": 2,
    "temperature": 1.0,
    "confounders": "estimated",
    "gating": "per_step",
    "interaction": "graph",
    "decoding": "autoregressive",
}
IN = {"hidden_dim": HIDDEN_DIM, "edge_layers": 4, "node_layers": 2, "radius": None, "confounders": None}
ALONGSIDE = {
    "hidden_dim": HIDDEN_DIM,
    "edge_layers": 3,
    "temperature": 1.0,
    "arena_half_width": None,
    "max_step": 3.2,
    "replay": True,
    "impulses": True,
    "pair_memory": True,
    "object_type": False,
    "pose": False,
}
NEAR = {"radius": 2.0}  # metres; some random objects are nearer, some are not
TRUE, WITHOUT_POSE = {"confounders": "ground_truth"}, {"confounders": "without_pose"}
COPHYNETS: dict[str, dict[str, Any]] = {
    "cophynet": {},
    "static_gating": {"gating": "static"},
    "mlp": {"interaction": "mlp", "slots": ["a", "b", "c", "d"]},
    "single_step": {"decoding": "single_step", "num_frames": NUM_FRAMES},
    "feedforward": {"confounders": "none"},
    "cophynet_true": TRUE,
    "cophynet_without_pose": WITHOUT_POSE,
}
INTERACTION_NETWORKS: dict[str, dict[str, Any]] = {
    "in": {},
    "npe": NEAR,
    "in_true": TRUE,
    "in_without_pose": WITHOUT_POSE,
    "npe_true": NEAR | TRUE,
}
ALONGSIDES: dict[str, dict[str, Any]] = {
    "alongside": {},
    "alongside_walls": {"arena_half_width": 2.0},
    "alongside_no_replay": {"replay": False},
    "alongside_no_impulses": {"impulses": False},
    "alongside_no_pair_memory": {"pair_memory": False},
}
GNS_ARGUMENTS = {
    "hidden_dim": HIDDEN_DIM,
    "message_steps": 2,
    "num_velocities": 3,
    "max_step": 3.2,
    "estimate_dim": 20,
    "gru_layers": 2,
    "edge_layers": 3,
    "node_layers": 2,
    "arena_half_width": None,
}
HYPOTHESES = {"hidden_dim": HIDDEN_DIM, "num_frames": NUM_FRAMES, "block_size": 1.0, "pose": False}
TRANSFORMER = {"hidden_dim": HIDDEN_DIM, "num_layers": 2, "num_heads": 3}
OTHERS: dict[str, tuple[type[nn.Module], dict[str, Any]]] = {
    "gns": (GNS, GNS_ARGUMENTS),
    "gns_walls": (GNS, GNS_ARGUMENTS | {"arena_half_width": 2.0}),
    "transformer": (Transformer, TRANSFORMER),
    "hypotheses": (Hypotheses, HYPOTHESES),
}
TRAINED = (*COPHYNETS, *INTERACTION_NETWORKS, *ALONGSIDES, *OTHERS)
SEES_APPEARANCE = {"object_type": True, "pose": True}


def build(name: str, **changes: Any) -> nn.Module:
    """Build a network whose weights follow from seed 0."""
    torch.manual_seed(0)
    if name in COPHYNETS:
        return CoPhyNet(**COPHYNET | COPHYNETS[name] | changes)
    if name in INTERACTION_NETWORKS:
        return InteractionNetwork(**IN | INTERACTION_NETWORKS[name] | changes)
    if name in ALONGSIDES:
        return Alongside(**ALONGSIDE | ALONGSIDES[name] | changes)
    if name in OTHERS:
        kind, arguments = OTHERS[name]
        if name == "hypotheses":  # for towers, whose objects have one type
            changes.pop("object_type", None)
        return kind(**arguments | changes)
    return {"copy_b": CopyB, "copy_c": CopyC, "copy_b_displaced": DisplacedCopyB}[name]()


def random_batch(num_slots: int, num_objects: list[int], num_frames: int = NUM_FRAMES) -> Batch:
    """Return random experiments with these numbers of objects; in every second one, an object is removed."""
    size, generator = len(num_objects), torch.Generator().manual_seed(0)
    order = torch.rand(size, num_slots, generator=generator).argsort(dim=1)
    observed_presence = order < torch.tensor(num_objects)[:, None]
    presence = observed_presence & ((order > 0) | (torch.arange(size) % 2 == 0)[:, None])

    def random(*shape: int) -> Tensor:
        return torch.randn(size, *shape, generator=generator)

    inputs = Inputs(
        observed=random(num_frames, num_slots, 3) * observed_presence[:, None, :, None],
        observed_presence=observed_presence,
        observed_stable=random(num_frames - 1, num_slots) > 0,
        initial=random(num_slots, 3) * presence[..., None],
        presence=presence,
        confounders=random(num_slots, len(CONFOUNDERS)) * observed_presence[..., None],
        object_type=random(num_slots, len(OBJECT_TYPES)) * observed_presence[..., None],
        pose=random(num_slots, len(POSE)) * observed_presence[..., None],
    )
    targets = Targets(
        position=random(num_frames - 1, num_slots, 3),
        stable=random(num_frames - 1, num_slots) > 0,
        presence=presence,
        initial=inputs.initial,
        observed_presence=observed_presence,
        confounder_class=torch.zeros(size, num_slots, 2, dtype=torch.long),
        pair=torch.arange(size) // 2,
        cell=torch.zeros(size, dtype=torch.long),
    )
    return Batch(inputs, targets)


def permute_slots(inputs: Inputs, order: list[int]) -> Inputs:
    """Return the same experiments with their slots in another order."""
    tensors = {field.name: getattr(inputs, field.name) for field in fields(inputs)}
    index = torch.tensor(order)
    return Inputs(
        **{name: t if t is None else t.index_select(SLOT_AXIS.get(name, 1), index) for name, t in tensors.items()}
    )


def with_noise_where_absent(inputs: Inputs) -> Inputs:
    """Return the same experiments with random values wherever an object is absent."""
    in_ab = (~inputs.observed_presence)[..., None]
    absent = {"observed": in_ab[:, None], "initial": ~inputs.presence[..., None]}
    absent |= dict.fromkeys(("confounders", "object_type", "pose"), in_ab)
    tensors = {name: getattr(inputs, name) for name in absent if getattr(inputs, name) is not None}
    return replace(inputs, **{name: torch.where(absent[name], torch.randn_like(t), t) for name, t in tensors.items()})


def present_positions(prediction: Prediction, inputs: Inputs) -> Tensor:
    """Return the predicted positions of present objects; zero for all others."""
    return prediction.position * inputs.presence[:, None, :, None]
