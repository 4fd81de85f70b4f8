"""Experiments and their pictures, whoever made them: what callers may ask of generated and of released data alike."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cophy.dataset.pictures.needed_frames import ALL, NeededFrames
from cophy.dataset.store.shardset import ShardSet
from cophy.scenario.rendering.frames import RenderSettings

Clip = tuple[int, int, np.ndarray, np.ndarray]  # experiment of a shard, sequence, times (N,), RGB (N, R, R, 3) uint8
Reader = Callable[[int, int, int], np.ndarray]  # row of the arrays, sequence, time -> RGB (R, R, 3) uint8
Pictures = Callable[[int], dict[str, np.ndarray]]  # row of the arrays -> both sequences, by modality


ORACLES = ("feedforward", "initial_velocity", "confounders", "counterfactual")  # docs/benchmark/oracles.md


@dataclass(frozen=True)
class OracleSettings:
    """What the oracles are asked with, explained in conf/model/.

    draws: of D where not all that could be is enumerated. max_configurations: how many configurations are tried on AB.
    noise: how far every observed coordinate may be off, m. max_experiments: so many test experiments are asked about, the first
    ones.
    """

    draws: int
    max_configurations: int
    noise: float
    max_experiments: int


class ExperimentSet(ShardSet):
    """Experiments of one scenario with one number of objects, as `load` returns them."""

    @property
    @abstractmethod
    def id(self) -> str:
        """Name of the data: other experiments, or other splits of them, have another one."""

    @property
    @abstractmethod
    def remedy(self) -> str:
        """What a person does who finds too few experiments in it."""

    @abstractmethod
    def frames(self, render: RenderSettings, needed: NeededFrames = ALL) -> "FrameSource":
        """Pictures of the experiments; released ones are as they are, whatever `render` says.

        Args:
            render: How they are drawn.
            needed: Which of them anybody looks at.
        """

    @abstractmethod
    def forecasts(self, settings: OracleSettings) -> ShardSet:
        """What the oracles say of the test experiments.

        Raises:
            CophyError: the data lack what a simulation starts from.
        """

    @abstractmethod
    def unseen_by(
        self, *, num_experiments: dict[str, dict[str, int]], data_seed: int, trained_on: Sequence[str]
    ) -> bool:
        """Whether a training left the test experiments of this set out.

        Args:
            num_experiments: of the size that was trained at, by scenario and number of objects.
            data_seed: of the datasets that were trained on.
            trained_on: their ids.
        """

    def command_for(self, script: str) -> str:
        """The command that runs another script of src/ on these experiments."""
        return self.command.replace(self.command.split()[1], f"src/{script}.py")


class FrameSource(Protocol):
    """RGB of frames of AB (sequence 0) and CD (1) of a set of experiments: of those that are needed."""

    @property
    def states(self) -> ExperimentSet:
        """The experiments that the frames show."""
        ...

    @property
    def name(self) -> str:
        """What the frames are a function of, besides the experiments."""
        ...

    @property
    def needed(self) -> NeededFrames:
        """Which frames there are."""
        ...

    def ensure(self, *, workers: int) -> None:
        """Make what is missing, of the experiments too."""
        ...

    def checksums(self) -> dict[str, str] | None:
        """SHA-256 per shard of the pictures, or None where they lie in no shards, or do so no more."""
        ...

    def sequences(self, shard: int) -> Iterator[Clip]:
        """The needed frames of a shard's experiments, in their order; a sequence without any is left out."""
        ...

    def reader(self, arrays: dict[str, np.ndarray]) -> Reader:
        """Reads frames of the experiments of these arrays; for one process alone."""
        ...

    def pictures(self, arrays: dict[str, np.ndarray], modalities: Sequence[str]) -> Pictures:
        """Reads both sequences of an experiment of these arrays, (2, T, R, R, ...) each; for one process alone.

        Raises:
            CophyError: there are no pictures of one of the modalities.
        """
        ...
