"""What a released format has to tell: where experiments and lists of ids lie, and how one experiment is read."""

from pathlib import Path
from typing import Protocol

from cophy.dataset.released.recording import Recording
from cophy.dataset.splits import Split
from cophy.scenario import Scenario


class ReleasedFormat(Protocol):
    """How someone laid out a dataset on disk.

    name: as `source=` has it. frame_step: every how many frames of states and clips one is taken.
    lists_by_shape: whether the splits by the moving object's shape have lists of their own.
    """

    name: str
    frame_step: int
    lists_by_shape: bool

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        """The folder whose subfolders are the experiments.

        Args:
            root: of the released dataset.
            scenario: of the experiments.
            num_objects: in A of each of them.
        """
        ...

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        """Names that a list of ids may have.

        Args:
            scenario: of the dataset.
            num_objects: in A.
            split: as `split=` has it.
            part: train, val or test.

        Raises:
            CophyError: the format has no lists for this split.
        """
        ...

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        """One experiment.

        Raises:
            BrokenFileError: a file is not what the format says.
            BrokenExperimentError: the files contradict each other or the scenario.
        """
        ...
