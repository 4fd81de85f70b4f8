"""Loading: experiments to predictors, frames to de-renderers."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from measure import REPEATS, Measured, cpu_seconds, paired
from speed_training import EXPERIMENTS_PER_EPOCH, KINDS, Step, network, random_batch, training_step

from cophy.config import composed, generated_by, settings, to_plain
from cophy.dataset.datamodules import CounterfactualDataset
from cophy.dataset.frames import FrameBatch, FrameDataModule
from cophy.models.derenderer import Derenderer
from cophy.training.checkpoints import build_network
from cophy.training.derenderer import DerenderingModule
from cophy.types import map_tensors

NUM_FRAMES = 1600


def measure() -> list[Measured]:
    """Measure ratios of loading to training."""
    model, experiments = network(), epoch_of_towers()
    load, train = epoch(experiments, lambda batch: None), epoch(experiments, training_step(model, model))
    copies = paired(load, lambda: map_tensors(torch.clone, experiments.batch))
    return [
        Measured("loading experiments", "epoch of batches ÷ one memory copy", copies),
        Measured("loading experiments", "epoch of batches ÷ training epoch", paired(load, train), "≤ 0.02"),
        *frames(),
    ]


def epoch_of_towers() -> CounterfactualDataset:
    """Draw as many random experiments as the training split of size=small has."""
    return CounterfactualDataset(random_batch(EXPERIMENTS_PER_EPOCH, *KINDS["towers, 3 of 4 slots"]))


def epoch(experiments: CounterfactualDataset, step: Step) -> Callable[[], object]:
    """Return a function that runs the step on every batch of the default size."""
    batch_size = settings("train").training.batch_size
    return lambda: [step(batch) for batch in experiments.shuffled(batch_size)]


def frames() -> list[Measured]:
    """Measure the CPU time of receiving a batch of frames from two workers ÷ that of a training step.

    The second ratio is a worker's own time per batch ÷ a step: how many workers a training process needs.
    """
    with tempfile.TemporaryDirectory() as data_dir:
        data = frame_data(Path(data_dir))
        step = derendering_step(data)
        waiting, working = [], []
        for _ in range(REPEATS):
            fetching, training, alone = frame_epoch(data, step)
            waiting.append(fetching / training)
            working.append(alone / training)
    return [
        Measured("frames, 2 workers", "CPU to receive a batch ÷ de-renderer's step", waiting, "≤ 0.05"),
        Measured("frames, one worker's CPU", "to read a batch ÷ de-renderer's step", working, "≤ 2"),
    ]


def frame_epoch(data: FrameDataModule, step: Callable[[FrameBatch], object]) -> tuple[float, float, float]:
    """Measure the CPU-s of this process to receive all batches, to train on them, and to read all frames itself."""
    batches, fetched = iter(data.train_dataloader()), list[FrameBatch]()
    fetching = cpu_seconds(lambda: fetched.extend(batches))
    training = cpu_seconds(lambda: [step(batch) for batch in fetched])
    return fetching, training, cpu_seconds(lambda: [data.train[item] for item in range(len(data.train))])


def frame_data(data_dir: Path) -> FrameDataModule:
    """Render NUM_FRAMES frames of towers, for loading by two workers."""
    chosen = settings("train", "model=derenderer", "size=tiny")
    data = FrameDataModule(
        generated_by(replace(chosen, data_dir=str(data_dir))),
        render=chosen.render,
        resolution=chosen.model.resolution,
        num_images=NUM_FRAMES,
        data_seed=0,
        batch_size=chosen.training.batch_size,
        workers=2,
    )
    data.prepare_data()
    data.setup()
    return data


def derendering_step(data: FrameDataModule) -> Callable[[FrameBatch], object]:
    """Return a training step of the de-renderer with Adam."""
    torch.manual_seed(0)
    model = build_network(to_plain(composed("train", "model=derenderer").model))
    assert isinstance(model, Derenderer)
    model.scale_(*data.train.position_statistics())
    module = DerenderingModule(model, settings("train", "model=derenderer").training)
    module.log = module.log_dict = lambda *args, **kwargs: None  # type: ignore[method-assign, assignment]
    optimizer = torch.optim.Adam(model.parameters())

    def step(batch: FrameBatch) -> None:
        loss = module.training_step(batch)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()

    return step
