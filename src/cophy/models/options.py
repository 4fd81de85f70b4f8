"""Switches of the models, as configuration spells them."""

from enum import Enum


class ConfounderSource(Enum):
    """Where a predictor's confounders come from: AB, the ground truth, or nowhere (a feedforward model)."""

    estimated = "estimated"
    ground_truth = "ground_truth"
    none = "none"


class Gating(Enum):
    """When stability is decided: at every step, or once per sequence from C and U (paper Table 6 left)."""

    per_step = "per_step"
    static = "static"
