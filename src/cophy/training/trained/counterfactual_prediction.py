"""From the pictures of AB and C, with two checkpoints, to D (the whole of the paper's Fig. 2)."""

from typing import NamedTuple

import numpy as np
import torch

from cophy.dataset.feed.batches import estimated_inputs
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.training.model_contract import NOT_FINITE
from cophy.training.trained.checkpoints import made_from
from cophy.training.trained.trained_derenderer import TrainedDerenderer
from cophy.training.trained.trained_predictor import TrainedPredictor


class Counterfactual(NamedTuple):
    """What is predicted of CD. positions: (T, K, 3) metres, C and then D. presence: (K,) the objects found in C."""

    positions: np.ndarray
    presence: np.ndarray


def check_pair(derenderer: TrainedDerenderer, predictor: TrainedPredictor) -> None:
    """Refuse checkpoints of two scenarios, or of one with other colours."""
    if derenderer.scenario != predictor.scenario.name:
        raise CophyError(f"the de-renderer is of {derenderer.scenario}, the predictor of {predictor.scenario.name}")
    if derenderer.slots != (slots := list(predictor.scenario.colors)):
        seen, known = ", ".join(derenderer.slots), ", ".join(slots)
        raise CophyError(f"derenderer={derenderer.source} sees {seen}, predictor={predictor.source} knows {known}")


def predict(
    observed: np.ndarray, initial: np.ndarray, derenderer: TrainedDerenderer, predictor: TrainedPredictor
) -> Counterfactual:
    """What would have happened from C, having seen AB.

    Args:
        observed: (T, R, R, 3) uint8 RGB frames of AB.
        initial: (R, R, 3) uint8 RGB picture of C.
        derenderer: Finds the objects in both.
        predictor: Predicts D from them.

    Raises:
        CophyError: The pictures are not those that the checkpoints know, or show no object; or what a checkpoint says of
            them is not finite.
    """
    _check_pictures(observed, initial, predictor.scenario)
    position, logit = derenderer(observed)
    position_in_c, logit_in_c = (
        np.broadcast_to(value, like.shape)
        for value, like in zip(derenderer(initial[None]), (position, logit), strict=True)
    )
    estimates = {
        "position": np.stack([position, position_in_c])[None],
        "presence_logit": np.stack([logit, logit_in_c])[None],
    }
    _check_finite(estimates["position"], f"derenderer={derenderer.source}")
    inputs = estimated_inputs(estimates, predictor.scenario)
    if not inputs.presence.any():
        raise CophyError("the de-renderer sees no object in C: is it trained, and is the picture of its scenario?")
    with torch.no_grad(), made_from(predictor.source):  # some arguments of a network are only used here
        prediction = predictor.network(inputs)
        positions = torch.cat([inputs.initial[:, None], prediction.position], dim=1).numpy()
    _check_finite(positions, f"predictor={predictor.source}")
    return Counterfactual(positions[0], inputs.presence[0].numpy())


def _check_finite(positions: np.ndarray, checkpoint: str) -> None:
    if not np.isfinite(positions).all():
        raise CophyError(f"{checkpoint} {NOT_FINITE}")


def _check_pictures(observed: np.ndarray, initial: np.ndarray, scenario: Scenario) -> None:
    clock = scenario.clock
    if len(observed) != clock.num_frames:
        known = f"the predictor knows {clock.num_frames}, at {clock.frame_rate_hz} per second"
        raise CophyError(f"AB has {len(observed)} frames; {known}")
    for name, frame in (("AB", observed[0]), ("C", initial)):
        if frame.shape[0] != frame.shape[1]:
            raise CophyError(f"the pictures of {name} are {frame.shape[1]} × {frame.shape[0]} pixels, not square")
