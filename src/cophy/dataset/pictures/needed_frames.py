"""Which frames of a dataset are drawn: all of them, or only those that somebody looks at."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cophy.dataset.splits import SPLITS

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
        keys: Of the training that looks at them.
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
