"""What a layout has to tell: where experiments and lists of ids lie, and how one experiment's files are read."""

from pathlib import Path
from typing import Protocol

import numpy as np

from cophy.dataset.external.recording import BrokenExperimentError, Recording
from cophy.dataset.splits import Split
from cophy.scenario import Scenario

TASKS = {"blocktower": "blocktowerCF", "balls": "ballsCF", "collision": "collisionCF"}


class Layout(Protocol):
    """name: as `source=` has it. frame_step: every how many frames of states and clips one is taken.

    lists_by_shape: whether the splits by the moving object's shape have lists of their own.
    """

    name: str
    frame_step: int
    lists_by_shape: bool

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        """The folder whose subfolders are the experiments."""
        ...

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        """Names that the list of ids of a part (train, val, test) may have."""
        ...

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        """One experiment; raises BrokenFileError or BrokenExperimentError."""
        ...


def layout_named(name: str) -> Layout:
    """The layout that `source=` names."""
    from cophy.dataset.external.cophy import CoPhy
    from cophy.dataset.external.filtered_cophy import FilteredCoPhy

    layouts: dict[str, Layout] = {layout.name: layout for layout in (CoPhy(), FilteredCoPhy())}
    return layouts[name]


def sampled(states: np.ndarray, scenario: Scenario, frame_step: int) -> np.ndarray:
    """(T · frame_step, column, 13) -> (T, column, 13), the states that the scenario's frames show."""
    length = scenario.clock.num_frames * frame_step
    if states.ndim != 3 or states.shape[2] != 13:
        raise BrokenExperimentError(f"states.npy has shape {states.shape}, not (time, object, 13)")
    if len(states) != length:
        raise BrokenExperimentError(f"states.npy has {len(states)} frames, not {length}")
    return states[::frame_step]


def in_slots(columns: np.ndarray, slots: list[int], num_slots: int) -> np.ndarray:
    """(T, column, 13) -> (T, slot, 13)."""
    states = np.zeros((len(columns), num_slots, 13))
    states[:, slots[: columns.shape[1]]] = columns
    return states


def slot_of(color: str, scenario: Scenario) -> int:
    """The slot of a colour."""
    if color not in scenario.colors:
        raise BrokenExperimentError(f"colour {color[:20]!r} is not among {', '.join(scenario.colors)}")
    return list(scenario.colors).index(color)


def clip_frames(counts: tuple[int, int], scenario: Scenario, frame_step: int) -> tuple[int, int]:
    """The lengths of AB's and CD's clips, if they are those of the states; 0 where there is no clip."""
    expected = scenario.clock.num_frames * frame_step
    for sequence, count in zip(("ab", "cd"), counts, strict=True):
        if count not in (0, expected):
            raise BrokenExperimentError(f"{sequence}/rgb.mp4 has {count} frames, not {expected}")
    return counts
