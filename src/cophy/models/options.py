"""Switches of the models, as configuration spells them."""

from enum import Enum


class ConfounderSource(Enum):
    """Where CoPhyNet's confounders come from: AB, the ground truth, or nowhere (a feedforward model)."""

    estimated = "estimated"
    ground_truth = "ground_truth"
    none = "none"


class ConfounderInput(Enum):
    """What a model that never sees AB may be given besides C (or null: nothing)."""

    ground_truth = "ground_truth"


class Gating(Enum):
    """When stability is decided: at every step, or once per sequence from C and U (paper Table 6 left)."""

    per_step = "per_step"
    static = "static"


class Interaction(Enum):
    """How objects hear of each other: graph convolution, or an MLP over the concatenated slots (paper Table 6 left)."""

    graph = "graph"
    mlp = "mlp"


class Decoding(Enum):
    """How D is predicted: step by step, or all of it at once (paper Table 6 left)."""

    autoregressive = "autoregressive"
    single_step = "single_step"


class Readout(Enum):
    """How a de-renderer reads positions off its maps: by where an object is and how it looks there, or linearly (paper)."""

    attention = "attention"
    linear = "linear"
