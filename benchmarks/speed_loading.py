"""Loading: experiments to predictors, frames to de-renderers."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import torch
from measure import REPEATS, Measured, composed, cpu_seconds, paired, settings
from omegaconf import OmegaConf
from speed_training import network, random_batch, training_step

from cophy.dataset.counterfactual import CounterfactualDataset
from cophy.dataset.frames import FrameBatch, FrameDataModule
from cophy.models.derenderer import Derenderer
from cophy.training.derendering import DerenderingModule
from cophy.training.run import build_network

NUM_EXPERIMENTS = 2800  # that train at size=small


def measure() -> list[Measured]:
    """Ratios of loading to training."""
    batch_size, model = settings("train").training.batch_size, network()
    experiments, step = CounterfactualDataset(random_batch(NUM_EXPERIMENTS, 4, 3)), training_step(model, model)

    def load() -> None:
        for _ in experiments.loader(batch_size, shuffle=True):
            pass

    def copy() -> None:
        for tensor in filter(torch.is_tensor, experiments.batch):
            tensor.clone()

    def train() -> None:
        for batch in experiments.loader(batch_size, shuffle=True):
            step(batch)

    return [
        Measured("loading experiments", "epoch of batches ÷ one memory copy", paired(load, copy)),
        Measured("loading experiments", "epoch of batches ÷ training epoch", paired(load, train), "≤ 0.02"),
        *frames(),
    ]


def frames() -> list[Measured]:
    """CPU time that the training process spends on getting a batch of frames from two workers ÷ on a training step.

    A worker's own time per batch ÷ a step says how much of a worker a training process needs.
    """
    with tempfile.TemporaryDirectory() as data_dir:
        data = frame_data(Path(data_dir))
        step = derendering_step(data)
        waiting, working = [], []
        for _ in range(REPEATS):
            batches = iter(data.train_dataloader())
            fetched: list[FrameBatch] = []
            fetching = cpu_seconds(lambda batches=batches, fetched=fetched: fetched.extend(batches))
            training = cpu_seconds(lambda fetched=fetched: [step(batch) for batch in fetched])
            alone = cpu_seconds(lambda: [data.train[item] for item in range(len(data.train))])
            waiting.append(fetching / training)
            working.append(alone / training)
    return [
        Measured("frames, 2 workers", "CPU to receive a batch ÷ de-renderer's step", waiting, "≤ 0.05"),
        Measured("frames, one worker's CPU", "to read a batch ÷ de-renderer's step", working, "≤ 2"),
    ]


def frame_data(data_dir: Path) -> FrameDataModule:
    """1,600 frames of freshly drawn towers, two workers."""
    chosen = settings("train", "model=derenderer", "size=tiny")
    data = FrameDataModule(
        scenario=chosen.scenario,
        split=chosen.split,
        num_objects=None,
        size=chosen.size,
        seed=0,
        data_dir=data_dir,
        source=chosen.source,
        render=chosen.render,
        resolution=chosen.model.resolution,
        num_frames=1600,
        batch_size=chosen.training.batch_size,
        workers=2,
    )
    data.prepare_data()
    data.setup()
    return data


def derendering_step(data: FrameDataModule) -> Callable[[FrameBatch], None]:
    """Forward, backward and Adam of the de-renderer as conf/ has it."""
    config = composed("train", "model=derenderer", "size=tiny")
    torch.manual_seed(0)
    model = build_network(OmegaConf.to_container(config.model, resolve=True, enum_to_str=True))
    assert isinstance(model, Derenderer)
    model.scale_(*data.train.position_statistics())
    module = DerenderingModule(model, settings("train", "model=derenderer").training, config={})
    module.log = module.log_dict = lambda *args, **kwargs: None  # type: ignore[method-assign, assignment]
    optimizer = torch.optim.Adam(model.parameters())

    def step(batch: FrameBatch) -> None:
        loss = module.training_step(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return step
