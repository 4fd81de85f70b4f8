"""Every training experiment, turned and mirrored at random as the physics of its scenario allows, and seen less exactly."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cophy.dataset.datamodules import ALONE, Share
from cophy.scenario import Scenario
from cophy.training.settings import Augmentation
from cophy.types import HORIZONTAL, POSE_ANGLES, Batch


def matrices_of(scenario: Scenario, augmentation: Augmentation) -> np.ndarray:
    """(matrix, 2, 2) on (x, y), by one of which each training experiment is turned; the first is the identity."""
    if augmentation is Augmentation.physics:
        return scenario.augmentations()
    return scenario.symmetries()[: None if augmentation is Augmentation.symmetries else 1]


def augment(batch: Batch, matrices: Float[Tensor, "matrix 2 2"], draw: tuple[int, ...], share: Share = ALONE) -> Batch:
    """Apply to each experiment one of the matrices, drawn at random.

    Args:
        batch: This device's share of the experiments of a step.
        matrices: See `matrices_of`.
        draw: The choice follows from it alone: seed, epoch and step, so that a resumed training makes the same one.
        share: Of this device.
    """
    rng = np.random.default_rng(draw)
    choice = rng.integers(len(matrices), size=share.devices * len(batch))[share.rank :: share.devices]
    return transform(batch, matrices[torch.from_numpy(choice).to(matrices.device)])


def transform(batch: Batch, matrices: Float[Tensor, "batch 2 2"]) -> Batch:
    """The batch in other coordinates: each matrix acts on x and y of AB, C, D, confounders and poses alike."""
    inputs, targets = batch.inputs, batch.targets
    turned = replace(inputs, observed=_turned(inputs.observed, matrices), initial=_turned(inputs.initial, matrices))
    if inputs.confounders is not None:
        turned.confounders = _turned_confounders(inputs.confounders, matrices)
    if inputs.pose is not None:
        turned.pose = _turned_pose(inputs.pose, matrices)
    truth = replace(targets, position=_turned(targets.position, matrices), initial=_turned(targets.initial, matrices))
    return Batch(turned, truth)


def disturb(batch: Batch, most: float, draw: tuple[int, ...], share: Share = ALONE) -> Batch:
    """The batch with positions of AB and C about as inexact as a de-renderer's: every coordinate in every frame is off.

    All are off independently of each other. D, presence and what is said about stability stay true.

    Args:
        batch: This device's share of the experiments of a step.
        most: Largest standard deviation of a coordinate, metres. That of each experiment is drawn between 0 and this, so
            that nearly true positions are among what is seen.
        draw: As that of `augment`.
        share: Of this device.
    """
    rng, inputs = np.random.default_rng((*draw, len(draw))), batch.inputs  # other numbers than those of `augment`
    deviation = rng.uniform(0, most, share.devices * len(batch)).astype(np.float32)

    def off(
        position: Float[Tensor, "batch *any 3"], presence: Bool[Tensor, "batch *any"]
    ) -> Float[Tensor, "batch *any 3"]:
        shape = (len(deviation), *position.shape[1:])
        noise = rng.standard_normal(shape, dtype=np.float32) * deviation.reshape(-1, *[1] * (len(shape) - 1))
        return position + torch.from_numpy(noise[share.rank :: share.devices]).to(position) * presence[..., None]

    observed = off(inputs.observed, inputs.observed_presence[:, None].expand(inputs.observed.shape[:-1]))
    return replace(batch, inputs=replace(inputs, observed=observed, initial=off(inputs.initial, inputs.presence)))


def _turned(
    position: Float[Tensor, "batch *any 3"], matrices: Float[Tensor, "batch 2 2"]
) -> Float[Tensor, "batch *any 3"]:
    xy = torch.einsum("bij,b...j->b...i", matrices, position[..., :2])
    return torch.cat([xy, position[..., 2:]], dim=-1)


def _turned_confounders(
    confounders: Float[Tensor, "batch slots features"], matrices: Float[Tensor, "batch 2 2"]
) -> Float[Tensor, "batch slots features"]:
    turned = confounders.clone()
    for columns in HORIZONTAL:
        turned[..., columns] = torch.einsum("bij,bkj->bki", matrices, confounders[..., columns])
    return turned


def _turned_pose(
    pose: Float[Tensor, "batch slots 7"], matrices: Float[Tensor, "batch 2 2"]
) -> Float[Tensor, "batch slots 7"]:
    turned, doubled = pose.clone(), _doubled(matrices)
    for n, multiple in ((1, matrices), (2, doubled), (4, _doubled(doubled))):
        columns = POSE_ANGLES[n]
        turned[..., columns] = torch.einsum("bij,bkj->bki", multiple, pose[..., columns])
    return turned


def _doubled(matrices: Float[Tensor, "batch 2 2"]) -> Float[Tensor, "batch 2 2"]:
    """What turns (cos 2ψ, sin 2ψ) as the given matrices turn (cos ψ, sin ψ): by twice the angle, mirrored alike."""
    (cos, sin), (other_cos, other_sin) = matrices[:, :, 0].unbind(1), matrices[:, :, 1].unbind(1)
    mirrored = cos * other_sin - sin * other_cos  # the determinant: 1, or -1 where it mirrors
    cos_twice, sin_twice = cos.square() - sin.square(), 2 * cos * sin
    first, second = (cos_twice, sin_twice), (-mirrored * sin_twice, mirrored * cos_twice)
    return torch.stack([torch.stack(column, dim=-1) for column in (first, second)], dim=-1)
