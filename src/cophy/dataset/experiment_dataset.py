"""Whole experiments as named tensors, for code of one's own: `cophy.load`."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from cophy.dataset.experiment_set import ExperimentSet, FrameSource, Pictures
from cophy.dataset.splits import SPLITS
from cophy.scenario import Scenario

SIGNED = {np.dtype("<u2"): "<i4"}  # which torch can hardly compute with


class ExperimentDataset(Dataset[dict[str, Tensor]]):
    """Experiments of one split: states and confounders in memory, pictures read when they are asked for.

    An item is a dict of the arrays of one experiment by the names of the fields (docs/data/index.md). In what has two sequences, 0 is
    the observed AB and 1 the counterfactual CD. Pictures: rgb (2, T, R, R, 3) uint8; depth (2, T, R, R) int32, mm;
    segmentation (2, T, R, R) uint8. Items of one dataset have equal shapes, so a DataLoader batches them.

    Attributes:
        scenario: Names of slots, do-operations and cells, the clock, the camera.
        rows: Which experiments of all these are.
    """

    def __init__(
        self,
        experiments: ExperimentSet,
        *,
        split: str | None,
        frames: FrameSource | None = None,
        modalities: Sequence[str] = (),
    ) -> None:
        """Load the states.

        Args:
            experiments: A finished set.
            split: train, val or test; None for all.
            frames: Pictures of the set.
            modalities: Those of the pictures that are read.

        Raises:
            CophyError: The set is damaged.
        """
        arrays = experiments.load()
        chosen = np.ones(len(arrays["split"]), bool) if split is None else arrays["split"] == SPLITS.index(split)
        self.scenario: Scenario = experiments.spec.scenario
        self.rows = np.flatnonzero(chosen)
        self.arrays = {name: array[chosen] for name, array in arrays.items()}
        self._title = experiments.title
        self._frames, self._modalities = frames, tuple(modalities)
        self._where: dict[str, np.ndarray] = {name: arrays[name] for name in ("experiment", "clip") if name in arrays}
        self._pictures: Pictures | None = None  # of the process that reads

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, item: int) -> dict[str, Tensor]:
        found = {name: array[item] for name, array in self.arrays.items()}
        if self._frames is not None:
            if self._pictures is None:
                self._pictures = self._frames.pictures(self._where, self._modalities)
            found |= self._pictures(int(self.rows[item]))
        return {name: _tensor(value) for name, value in found.items()}

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {array.shape[1:]}" for name, array in self.arrays.items())
        pictures = "".join(f", {name}" for name in self._modalities)
        return f"{len(self)} experiments of {self._title}: {shapes}{pictures}"

    def __getstate__(self) -> dict[str, object]:
        """Without open files: every process opens its own."""
        return {**self.__dict__, "_pictures": None}


def _tensor(value: np.ndarray) -> Tensor:
    value = np.asarray(value)
    return torch.from_numpy(value.astype(SIGNED.get(value.dtype, value.dtype)))
