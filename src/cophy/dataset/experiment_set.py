"""Experiments and their pictures, whoever made them: what callers may ask of generated and of released data alike.

Which frames of a dataset are drawn: all of them, or only those that somebody looks at.
"""

import hashlib
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from cophy.dataset.shards import Sharded, ShardSet
from cophy.dataset.splits import SPLITS
from cophy.scenario.rendering import RenderSettings

EVERYTHING = "all"


@dataclass(frozen=True)
class NeededFrames:
    """A choice of frames that is the same for every experiment of a split.

    Attributes:
        name: In `frames=`, and in names of directories.
        splits: Whose experiments are looked at.
        whole_cd: Whether all of CD is; else only its first frame, C. Of AB every frame is.
        wider: Choices that have all of these frames and more, narrow ones first.
    """

    name: str
    splits: tuple[str, ...] = SPLITS
    whole_cd: bool = False
    wider: tuple["NeededFrames", ...] = ()

    @property
    def drawn_by(self) -> tuple[str, str]:
        """The script that draws them, and the keys that ask it for them."""
        return "generate", "" if self.name == EVERYTHING else f" frames={self.name}"

    def of(self, split: np.ndarray, first: int, num_frames: int) -> np.ndarray:
        """(experiment, 2, T) bool: which frames of AB (0) and of CD (1) are needed.

        Args:
            split: (experiment,) of some experiments that follow each other, as the states have it.
            first: Index of the first of them in the dataset.
            num_frames: T.
        """
        needed = np.zeros((len(split), 2, num_frames), dtype=bool)
        looked_at = np.isin(split, [SPLITS.index(name) for name in self.splits])
        needed[looked_at, 0] = True
        needed[looked_at, 1, : None if self.whole_cd else 1] = True
        return needed


ALL = NeededFrames(EVERYTHING, whole_cd=True)
INPUTS = NeededFrames("inputs", wider=(ALL,))  # what models see: AB and C
TEST_INPUTS = NeededFrames("test_inputs", splits=("test",), wider=(INPUTS, ALL))
FRAMES: Mapping[str, NeededFrames] = {choice.name: choice for choice in (ALL, INPUTS, TEST_INPUTS)}


@dataclass(frozen=True)
class ChosenFrames(NeededFrames):
    """Single frames, as a de-renderer is trained on.

    Attributes:
        frames: Experiment, sequence and time of each.
        keys: Command-line keys of the training that reads them.
    """

    frames: tuple[tuple[int, int, int], ...] = ()
    keys: str = ""

    @classmethod
    def to_train(cls, frames: np.ndarray, keys: str) -> "ChosenFrames":
        """From an array (frame, 3); its order does not matter, nor does it if one is named twice."""
        chosen = np.unique(frames, axis=0).astype("<i8")
        name = f"chosen-{hashlib.sha256(chosen.tobytes()).hexdigest()[:6]}"
        return cls(name, wider=(ALL,), frames=tuple(map(tuple, chosen.tolist())), keys=keys)

    @property
    def drawn_by(self) -> tuple[str, str]:
        """The training."""
        return "train", f" {self.keys}"

    def of(self, split: np.ndarray, first: int, num_frames: int) -> np.ndarray:
        """(experiment, 2, T) bool, as of every choice."""
        needed = np.zeros((len(split), 2, num_frames), dtype=bool)
        chosen = np.array(self.frames, dtype=np.int64).reshape(-1, 3)
        here = chosen[(chosen[:, 0] >= first) & (chosen[:, 0] < first + len(split))]
        needed[here[:, 0] - first, here[:, 1], here[:, 2]] = True
        return needed


Clip = tuple[int, int, np.ndarray, np.ndarray]  # experiment of a shard, sequence, times (N,), RGB (N, R, R, 3) uint8
Reader = Callable[[int, int, int], np.ndarray]  # row of the arrays, sequence, time -> RGB (R, R, 3) uint8
Pictures = Callable[[int], dict[str, np.ndarray]]  # row of the arrays -> both sequences, by modality


class ExperimentSet(ShardSet):
    """Experiments of one scenario with one number of objects, as `load` returns them.

    script: the script of src/ that generates or indexes them. keys: its command-line keys, which other scripts share.
    """

    def __init__(self, spec: Sharded, directory: Path, *, title: str, script: str, keys: str) -> None:
        self._keys = keys
        super().__init__(spec, directory, title=title, command=f"python src/{script}.py {keys}")

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
        """Return the command that runs a script of src/ on these experiments."""
        return f"python src/{script}.py {self._keys}"


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
