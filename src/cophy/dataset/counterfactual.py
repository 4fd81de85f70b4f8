"""Arrays on disk -> tensors in memory, batched by slicing."""

from operator import itemgetter

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import BatchSampler, DataLoader, Dataset, RandomSampler, SequentialSampler

from cophy.dataset.splits import SPLITS, Part
from cophy.scenario import Scenario, Shape
from cophy.scenario.confounders import ConfounderGrid
from cophy.types import HORIZONTAL, Batch, map_fields


class CounterfactualDataset(Dataset[Batch]):
    """One split of a dataset, whole in memory; an index is a list of experiments, an item their `Batch`."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch

    def __len__(self) -> int:
        return len(self.batch.initial)

    def __getitem__(self, indices: list[int]) -> Batch:
        rows = torch.as_tensor(indices)
        return map_fields(itemgetter(rows), self.batch)

    def loader(self, batch_size: int, *, shuffle: bool) -> DataLoader[Batch]:
        """Batches of up to `batch_size` experiments, sliced at once: no worker processes are worth their cost."""
        sampler = RandomSampler(self) if shuffle else SequentialSampler(self)
        return DataLoader(self, sampler=BatchSampler(sampler, batch_size, drop_last=False), batch_size=None)


def to_batch(arrays: dict[str, np.ndarray], scenario: Scenario) -> Batch:
    """Positions at the frame rate, presence, raw confounders and stability labels of all experiments."""
    stride = scenario.clock.states_per_frame
    positions = torch.from_numpy(arrays["states"][:, :, ::stride, :, :3].copy())
    observed_presence, presence = torch.from_numpy(arrays["presence"]).unbind(1)
    observed_stable, stable = (
        torch.from_numpy(stable_frames(states, stride, scenario.task.stable_speed))
        for states in np.moveaxis(arrays["states"], 1, 0)
    )
    return Batch(
        observed=positions[:, 0],
        observed_presence=observed_presence,
        observed_stable=observed_stable,
        initial=positions[:, 1, 0],
        presence=presence,
        confounders=_confounders(arrays),
        confounder_class=_confounder_class(arrays, scenario.confounders),
        target=positions[:, 1, 1:],
        target_initial=positions[:, 1, 0],
        target_presence=presence,
        stable=stable,
    )


def with_estimates(batch: Batch, estimates: dict[str, np.ndarray], scenario: Scenario) -> Batch:
    """The batch with AB and C as a de-renderer saw them; what is to be predicted stays the truth.

    estimates: position (experiment, 2, T, K, 3) and presence_logit (experiment, 2, T, K). An object is in AB if most of its
    frames say so, and in CD if C does. It seems stable where it moves from frame to frame as slowly as stable objects do.
    """
    position, logit = (torch.from_numpy(estimates[name]) for name in ("position", "presence_logit"))
    observed_presence, presence = (logit[:, 0] > 0).float().mean(dim=1) > 0.5, logit[:, 1, 0] > 0
    return batch._replace(
        observed=position[:, 0] * observed_presence[:, None, :, None],
        observed_presence=observed_presence,
        observed_stable=_seems_stable(position[:, 0], scenario),
        initial=position[:, 1, 0] * presence[..., None],
        presence=presence,
    )


def _seems_stable(position: Tensor, scenario: Scenario) -> Tensor:
    """(experiment, T-1, K) from positions (experiment, T, K, 3) alone."""
    speed = (position[:, 1:] - position[:, :-1]).norm(dim=-1) * scenario.clock.frame_rate_hz
    return speed < scenario.task.stable_speed


def select(arrays: dict[str, np.ndarray], part: Part, split: str) -> dict[str, np.ndarray]:
    """The experiments of a part that belong to a split (train, val or test)."""
    rows = selected(arrays, part, split)
    return {name: array[rows] for name, array in arrays.items()}


def selected(arrays: dict[str, np.ndarray], part: Part, split: str) -> np.ndarray:
    """(experiment,) bool: those of a part that belong to a split."""
    return part.select(arrays) & (arrays["split"] == SPLITS.index(split))


def confounder_statistics(train: Batch) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (1 for constants) of each confounder over the objects of the training set.

    Horizontal components of vectors share theirs, with mean 0, so that a turned vector is turned after scaling too.
    """
    values = train.confounders[train.observed_presence]
    mean, deviation = values.mean(dim=0), values.std(dim=0)
    for columns in HORIZONTAL:
        mean[columns], deviation[columns] = 0.0, values[:, columns].square().mean().sqrt()
    return mean, torch.where(deviation > 0, deviation, 1.0)


def standardise(batch: Batch, statistics: tuple[Tensor, Tensor]) -> Batch:
    """The batch with its confounders centred and scaled; empty slots stay zero."""
    mean, deviation = statistics
    scaled = (batch.confounders - mean) / deviation * batch.observed_presence[..., None]
    return batch._replace(confounders=scaled)


def _confounders(arrays: dict[str, np.ndarray]) -> Tensor:
    """(experiment, slot, 12) in the order of `types.CONFOUNDERS`."""
    per_object = np.stack([arrays[name] for name in ("mass", "friction", "restitution")], axis=-1)
    gravity = np.broadcast_to(arrays["gravity"][:, None, :2], (*per_object.shape[:2], 2))
    initial = arrays["states"][:, 0, 0]
    shape = arrays["shape"][..., None]
    features = [per_object, gravity, initial[..., 7:10], shape == Shape.CYLINDER, axis_of(initial[..., 3:7], shape)]
    return torch.from_numpy(np.concatenate(features, axis=-1, dtype=np.float32))


def _confounder_class(arrays: dict[str, np.ndarray], grid: ConfounderGrid) -> Tensor:
    """(experiment, slot, 2) nearest value of the grid: mass, friction."""
    nearest = [
        np.abs(arrays[name][..., None] - np.array(values)).argmin(axis=-1)
        for name, values in (("mass", grid.mass), ("friction", grid.friction))
    ]
    return torch.from_numpy(np.stack(nearest, axis=-1))


def axis_of(quaternion_xyzw: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(experiment, slot, 3) direction of a cylinder's axis (its sign chosen so that x ≥ 0) or of a block's own x axis."""
    x, y, z, w = np.moveaxis(quaternion_xyzw, -1, 0)
    along_z = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    along_x = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], axis=-1)
    unsigned = np.where(along_z[..., :1] < 0, -along_z, along_z)
    return np.where(shape == Shape.CYLINDER, unsigned, np.where(shape == Shape.BOX, along_x, 0.0))


def stable_frames(states: np.ndarray, stride: int, stable_speed: float) -> np.ndarray:
    """(experiment, frame 1 ... T-1, slot): slow at every state after the frame before, up to and with this frame."""
    slow = np.linalg.norm(states[..., 7:10], axis=-1) < stable_speed
    num_frames = slow.shape[1] // stride
    after_first = slow[:, 1 : (num_frames - 1) * stride + 1]
    return np.asarray(after_first.reshape(len(slow), num_frames - 1, stride, -1).all(axis=2))
