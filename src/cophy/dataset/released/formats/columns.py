"""What the formats read alike: columns of states.npy, colours, and lengths of clips."""

from pathlib import Path

import numpy as np

from cophy.dataset.released.recording import BrokenExperimentError
from cophy.dataset.released.untrusted_files import count_frames, read_array
from cophy.scenario import Scenario

SEQUENCES = ("ab", "cd")  # folders of an experiment


def read_states(directory: Path, scenario: Scenario, frame_step: int) -> tuple[np.ndarray, np.ndarray]:
    """States of AB and of CD at the scenario's frames, as columns of states.npy.

    Args:
        directory: of the experiment.
        scenario: whose clock says how many frames there are.
        frame_step: states per frame.

    Returns:
        Two arrays (T, column, 13).

    Raises:
        BrokenExperimentError: a file has another shape.
    """
    ab, cd = (_sampled(read_array(directory / name / "states.npy"), scenario, frame_step) for name in SEQUENCES)
    return ab, cd


def in_slots(columns: np.ndarray, slots: list[int], num_slots: int) -> np.ndarray:
    """Move columns to the slots of their objects.

    Args:
        columns: (T, column, 13).
        slots: of each column.
        num_slots: of the scenario.

    Returns:
        (T, slot, 13); zero where there is no object.
    """
    states = np.zeros((len(columns), num_slots, 13))
    states[:, slots[: columns.shape[1]]] = columns
    return states


def slot_of(color: str, scenario: Scenario) -> int:
    """The slot of a colour."""
    if color not in scenario.colors:
        raise BrokenExperimentError(f"colour {color[:20]!r} is not among {', '.join(scenario.colors)}")
    return list(scenario.colors).index(color)


def clip_lengths(directory: Path, scenario: Scenario, frame_step: int) -> tuple[int, int]:
    """Frames of the RGB clips of AB and of CD.

    Args:
        directory: of the experiment.
        scenario: whose clock says how many frames there are.
        frame_step: frames of the clip per frame.

    Returns:
        The lengths; 0 where there is no clip.

    Raises:
        BrokenExperimentError: a clip has another length.
    """
    expected = scenario.clock.num_frames * frame_step
    counts = [count_frames(directory / name / "rgb.mp4") for name in SEQUENCES]
    for name, count in zip(SEQUENCES, counts, strict=True):
        if count not in (0, expected):
            raise BrokenExperimentError(f"{name}/rgb.mp4 has {count} frames, not {expected}")
    return counts[0], counts[1]


def _sampled(states: np.ndarray, scenario: Scenario, frame_step: int) -> np.ndarray:
    """(T · frame_step, column, 13) -> (T, column, 13), the states that the scenario's frames show."""
    length = scenario.clock.num_frames * frame_step
    if states.ndim != 3 or states.shape[2] != 13:
        raise BrokenExperimentError(f"states.npy has shape {states.shape}, not (time, object, 13)")
    if len(states) != length:
        raise BrokenExperimentError(f"states.npy has {len(states)} frames, not {length}")
    return states[::frame_step]
