"""What generated and released experiments have in common: an interface to them (`ExperimentSet`) and to their images
(`FrameSource`), and the choice of the frames that are rendered (`NeededFrames`).
"""

import hashlib
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from cophy.dataset.shards import Arrays, Sharded, ShardSet
from cophy.dataset.splits import FRACTIONS, SPLITS
from cophy.scenario.rendering import RenderSettings


@dataclass(frozen=True)
class NeededFrames:
    """Frames to render: sequences of all experiments of some splits, or single frames.

    Attributes:
        name: Value of `frames=`, and part of the names of directories.
        splits: Splits whose experiments need frames: all of AB, and C.
        whole_cd: Whether all of CD is needed.
        single: Experiment, sequence and time of single frames, which are needed instead.
        supersets: Choices that include all of these frames, the smallest first.
        script: The script that renders them.
        keys: Its keys that request them.
    """

    name: str
    splits: tuple[str, ...] = SPLITS
    whole_cd: bool = False
    single: tuple[tuple[int, int, int], ...] | None = None
    supersets: tuple["NeededFrames", ...] = ()
    script: str = "generate"
    keys: str = ""

    def mask(self, split: np.ndarray, first: int, num_frames: int) -> np.ndarray:
        """Return which frames of AB (0) and of CD (1) are needed, (experiment, 2, T) bool.

        Args:
            split: (experiment,) splits of consecutive experiments, as the states store them.
            first: Index of the first of them in the dataset.
            num_frames: T.
        """
        needed = np.zeros((len(split), 2, num_frames), dtype=bool)
        if self.single is not None:
            frames = np.array(self.single, dtype=np.int64).reshape(-1, 3)
            frames = frames[(frames[:, 0] >= first) & (frames[:, 0] < first + len(split))]
            needed[frames[:, 0] - first, frames[:, 1], frames[:, 2]] = True
            return needed
        rows = np.isin(split, [SPLITS.index(name) for name in self.splits])
        needed[rows, 0] = True
        needed[rows, 1, : None if self.whole_cd else 1] = True
        return needed

    def frames_per_experiment(self, num_experiments: int, num_frames: int) -> float:
        """Return how many frames of an experiment are needed, on average over a dataset."""
        if self.single is not None:
            return len(self.single) / num_experiments
        share = sum(fraction for name, fraction in zip(SPLITS, FRACTIONS, strict=True) if name in self.splits)
        return share * (2 * num_frames if self.whole_cd else num_frames + 1)


ALL_FRAMES = NeededFrames("all", whole_cd=True)
INPUTS = NeededFrames("inputs", supersets=(ALL_FRAMES,), keys="frames=inputs")  # what models see: AB and C
TEST = NeededFrames("test", splits=("test",), whole_cd=True, supersets=(ALL_FRAMES,), keys="frames=test")
TEST_INPUTS = NeededFrames(
    "test_inputs", splits=("test",), supersets=(TEST, INPUTS, ALL_FRAMES), keys="frames=test_inputs"
)
FRAMES = {choice.name: choice for choice in (ALL_FRAMES, INPUTS, TEST, TEST_INPUTS)}


def single_frames(frames: np.ndarray, keys: str) -> NeededFrames:
    """Return the choice of the frames that a de-renderer is trained on.

    Args:
        frames: (frame, 3) experiment, sequence and time; order and repetitions do not matter.
        keys: Command-line keys of the training.
    """
    frames = np.unique(frames, axis=0).astype("<i8")
    name = f"chosen-{hashlib.sha256(frames.tobytes()).hexdigest()[:6]}"
    single = tuple(map(tuple, frames.tolist()))
    return NeededFrames(name, single=single, supersets=(ALL_FRAMES,), script="train", keys=keys)


SequenceFrames = tuple[
    int, int, np.ndarray, np.ndarray
]  # experiment of a shard, sequence, times (N,), RGB (N, R, R, 3) uint8
FrameReader = Callable[[int, int, int], np.ndarray]  # row of the arrays, sequence, time -> RGB (R, R, 3) uint8
ReadImages = Callable[[int], Arrays]  # row of the arrays -> both sequences, by modality


class ExperimentSet(ShardSet):
    """Experiments of one scenario with one number of objects, as `load` returns them.

    script: the script of src/ that generates or indexes them. keys: its command-line keys, which other scripts share.
    """

    def __init__(self, spec: Sharded, directory: Path, *, title: str, script: str, keys: str) -> None:
        self._keys = keys
        super().__init__(spec, directory, title=title, command=self.command_for(script))

    @property
    @abstractmethod
    def id(self) -> str:
        """Unique name of the data; it changes if the experiments or their splits change."""

    @property
    @abstractmethod
    def remedy(self) -> str:
        """What the user can do if it contains too few experiments."""

    @abstractmethod
    def pairs(self, rows: np.ndarray) -> np.ndarray:
        """Return the twin pairs of experiments, equal for twins. They are for scoring only: the test split hides them.

        Args:
            rows: (experiment,) rows of the loaded arrays.
        """

    @abstractmethod
    def clusters(self, rows: np.ndarray) -> np.ndarray:
        """Return clusters of experiments for the bootstrap: twin pairs that were assigned the same confounders.

        Args:
            rows: (experiment,) rows of the loaded arrays.
        """

    @abstractmethod
    def frames(self, render: RenderSettings, needed: NeededFrames = ALL_FRAMES) -> "FrameSource":
        """Return the images of the experiments.

        Args:
            render: How they are rendered; it has no effect on released images.
            needed: Which frames are rendered.
        """

    @abstractmethod
    def has_same_splits(self, *, data_seed: int, trained_on: Sequence[str]) -> bool:
        """Return whether a training had the same splits, so that no test experiment of this set was trained on.

        Args:
            data_seed: Seed of the datasets of the training.
            trained_on: Ids of these datasets.
        """

    def invalid(self, arrays: Arrays, shard: int) -> Iterator[tuple[str, np.ndarray]]:
        yield from super().invalid(arrays, shard)
        present = arrays["presence"].any(axis=1)
        for name in ("mass", "shape"):
            yield f"{name} of an object is 0", (present & (arrays[name] == 0)).any(axis=1)

    def command_for(self, script: str) -> str:
        """Return the command that runs a script of src/ on these experiments."""
        return f"python src/{script}.py {self._keys}"


class FrameSource(Protocol):
    """RGB images of AB (sequence 0) and CD (1) of a set of experiments."""

    @property
    def states(self) -> ExperimentSet:
        """The experiments that the images show."""

    @property
    def name(self) -> str:
        """Name of the set of images: modalities, resolution and renderer."""

    @property
    def needed(self) -> NeededFrames:
        """Frames that the set contains."""

    def ensure(self, *, workers: int) -> None:
        """Generate what is missing, including the experiments."""

    def checksums(self) -> dict[str, str] | None:
        """Return the SHA-256 per shard of the images, or None if there are no shards (any more)."""

    def sequences(self, shard: int) -> Iterator[SequenceFrames]:
        """Yield the needed frames of each sequence of a shard; sequences without any are omitted."""

    def reader(self, arrays: Arrays) -> FrameReader:
        """Return a function that reads a frame of the experiments in `arrays`, for use in one process."""

    def pictures(self, arrays: Arrays, modalities: Sequence[str]) -> ReadImages:
        """Return a function that reads both sequences of an experiment in `arrays`, (2, T, R, R, ...) each, in one process.

        Raises:
            CophyError: There are no images of one of the modalities.
        """
