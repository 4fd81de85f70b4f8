"""Augmentation of training experiments: rotations and reflections that the scenario's physics allows, and position noise."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cophy.dataset.datamodules import ONE_DEVICE, DeviceShare
from cophy.models.frames import turn, turn_inputs
from cophy.scenario import Scenario
from cophy.training.settings import Augmentation
from cophy.types import Batch


def matrices_of(scenario: Scenario, augmentation: Augmentation) -> np.ndarray:
    """Return the (matrix, 2, 2) rotations and reflections of (x, y) to choose from; the first is the identity."""
    if augmentation is Augmentation.physics:
        return scenario.augmentations()
    return scenario.symmetries()[: None if augmentation is Augmentation.symmetries else 1]


def augment(
    batch: Batch, matrices: Float[Tensor, "matrix 2 2"], draw: tuple[int, ...], share: DeviceShare = ONE_DEVICE
) -> Batch:
    """Apply a random matrix to each experiment.

    Args:
        batch: This device's share of the experiments of a step.
        matrices: See `matrices_of`.
        draw: Seed, epoch and step, which determine the choice, so that a resumed training repeats it.
        share: This device's share of the batch.
    """
    rng = np.random.default_rng(draw)
    choice = rng.integers(len(matrices), size=share.devices * len(batch))[share.rank :: share.devices]
    return transform(batch, matrices[torch.from_numpy(choice).to(matrices.device)])


def transform(batch: Batch, matrices: Float[Tensor, "batch 2 2"]) -> Batch:
    """Change coordinates: each matrix acts on x and y of AB, C, D, confounders and poses alike."""
    targets = batch.targets
    truth = replace(targets, position=turn(targets.position, matrices), initial=turn(targets.initial, matrices))
    return Batch(turn_inputs(batch.inputs, matrices), truth)


def add_position_noise(batch: Batch, max_std: float, draw: tuple[int, ...], share: DeviceShare = ONE_DEVICE) -> Batch:
    """Add Gaussian noise to the positions of AB and C, independently per coordinate; D, presence and stability stay true.

    Args:
        batch: This device's share of the experiments of a step.
        max_std: Largest standard deviation, metres. That of each experiment is drawn uniformly between 0 and this.
        draw: Seed, epoch and step, as for `augment`.
        share: This device's share of the batch.
    """
    rng, inputs = np.random.default_rng((*draw, len(draw))), batch.inputs  # another stream than that of `augment`
    deviation = rng.uniform(0, max_std, share.devices * len(batch)).astype(np.float32)

    def noisy(
        position: Float[Tensor, "batch *any 3"], presence: Bool[Tensor, "batch *any"]
    ) -> Float[Tensor, "batch *any 3"]:
        shape = (len(deviation), *position.shape[1:])
        noise = rng.standard_normal(shape, dtype=np.float32) * deviation.reshape(-1, *[1] * (len(shape) - 1))
        return position + torch.from_numpy(noise[share.rank :: share.devices]).to(position) * presence[..., None]

    observed = noisy(inputs.observed, inputs.observed_presence[:, None].expand(inputs.observed.shape[:-1]))
    return replace(batch, inputs=replace(inputs, observed=observed, initial=noisy(inputs.initial, inputs.presence)))
