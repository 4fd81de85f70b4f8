"""The names of a run, and its place among the others."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Run:
    """What train.py does once.

    Attributes:
        scenario, split, model, ablation, positions, seed, size: The names under which it was chosen.
        directory: Where its results go.
    """

    scenario: str
    split: str
    model: str
    ablation: str
    positions: str
    seed: int
    size: str
    directory: Path

    def names(self) -> dict[str, Any]:
        """The names alone."""
        return {key: value for key, value in asdict(self).items() if key != "directory"}

    @property
    def place(self) -> Path:
        """The directory's path below the root of all runs (conf/train.yaml, hydra.run.dir)."""
        return Path(self.scenario, self.split, self.model, self.ablation, self.positions, f"seed{self.seed}")

    @property
    def root(self) -> Path | None:
        """The root of all runs, where the run lies in its place below it."""
        depth = len(self.place.parts)
        return self.directory.parents[depth - 1] if self.directory.parts[-depth:] == self.place.parts else None

    @property
    def checkpoints(self) -> Path:
        """The folder of its checkpoints."""
        return self.directory / "checkpoints"
