"""CoPhy_224, the paper's released dataset, and what its released tower generator writes."""

import re
from pathlib import Path

import numpy as np

from cophy.dataset.released.formats.columns import clip_lengths, in_slots, read_states, slot_of
from cophy.dataset.released.formats.cophy_tasks import TASKS, kind_of
from cophy.dataset.released.recording import BrokenExperimentError, Recording
from cophy.dataset.released.untrusted_files import BrokenFileError, read_array, read_text
from cophy.dataset.splits import Split
from cophy.scenario import Scenario, Shape

SHAPES = {"sphere": Shape.SPHERE, "cylinder_up": Shape.CYLINDER, "cylinder_down": Shape.CYLINDER}
COLOR = re.compile(r"(?:type=(\w+)\s+)?color=(\w+)")
GRAVITY = re.compile(r"gravity_x=(\S+)\s+gravity_y=(\S+)")


class CoPhy:
    """5 Hz, states by colour slot.

    The released tower generator writes states from bottom to top, and no colors.txt. Then it is unknown which mass belongs
    to which block. Its gravity.txt holds frictions. Confounders of blocks and gravity are therefore NaN.
    """

    name = "cophy"
    frame_step = 1
    lists_by_shape = True

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        return TASKS[scenario.name].directory(root, num_objects)

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        return [TASKS[scenario.name].list_of(part, num_objects, kind_of(split))]

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        ab, cd = read_states(directory, scenario, self.frame_step)
        types = _types_by_slot(directory / "ab" / "colors.txt", scenario)
        values = _confounders(directory / "confounders.npy", scenario)
        padded = _is_padded(ab, list(types), scenario.num_slots)
        if cd.shape[1] > ab.shape[1] or (padded and cd.shape[1] != ab.shape[1]):
            raise BrokenExperimentError(f"states.npy of AB have {ab.shape[1]} objects, of CD {cd.shape[1]}")
        slots = list(range(scenario.num_slots)) if padded else _slots(ab, list(types), values)
        left = slots if padded else _slots_left(directory / "cd" / "colors.txt", slots, cd.shape[1], scenario)
        states = np.stack([in_slots(*each, scenario.num_slots) for each in ((ab, slots), (cd, left))])
        known = bool(types) or ab.shape[1] > len(np.flatnonzero(ab[0].any(axis=-1)))
        if not known:
            values = np.full_like(values, np.nan)
        return Recording(
            states=states,
            shape=_shapes(types, scenario),
            order=_order(states[0, 0], scenario),
            mass=values[:, 0],
            friction=values[:, 1],
            restitution=values[:, 2],
            gravity_xy=_gravity_xy(directory / "gravity.txt", scenario, trusted=bool(types)),
            clip_frames=clip_lengths(directory, scenario, self.frame_step),
        )


def _types_by_slot(path: Path, scenario: Scenario) -> dict[int, str]:
    """Slot -> type (or "") in the order of colors.txt, towers from bottom to top; empty where there is no such file."""
    if not path.exists() and not path.is_symlink():
        return {}
    found = [match for line in read_text(path).splitlines() if (match := COLOR.search(line))]
    return {slot_of(match[2], scenario): match[1] or "" for match in found}


def _is_padded(ab: np.ndarray, slots: list[int], num_slots: int) -> bool:
    """Whether states.npy has one column per slot, empty slots included. Otherwise it has one per object."""
    return ab.shape[1] == num_slots and not _stacked_by_column(ab, slots)


def _stacked_by_column(ab: np.ndarray, slots: list[int]) -> bool:
    """Whether a file with one column per slot lists the blocks from bottom to top instead of by slot.

    A tower may fit both readings.
    """
    height = ab[0, :, 2]
    if not ab[0].any(axis=-1).all() or (np.diff(height) <= 0).any():
        return False
    return not slots or bool((np.diff(height[slots]) <= 0).any())


def _slots(ab: np.ndarray, listed: list[int], values: np.ndarray) -> list[int]:
    """The slot of each column, as colors.txt lists them.

    Without colors.txt: the slots that have a mass, in an order that is unknown.
    """
    slots, source = (listed, "colors.txt") if listed else (np.flatnonzero(values[:, 0] > 0).tolist(), "confounders.npy")
    if len(slots) != ab.shape[1]:
        raise BrokenExperimentError(f"states.npy has {ab.shape[1]} objects, {source} {len(slots)}")
    return slots


def _slots_left(path: Path, slots: list[int], num_columns: int, scenario: Scenario) -> list[int]:
    """The slot of each column of CD: as its colors.txt lists them, or else, where the top block was removed, those below."""
    listed = list(_types_by_slot(path, scenario))
    if len(listed) != num_columns:
        return slots
    if unknown := sorted(set(listed) - set(slots)):
        raise BrokenExperimentError(f"cd/colors.txt lists {list(scenario.colors)[unknown[0]]}, which is not in AB")
    return listed


def _confounders(path: Path, scenario: Scenario) -> np.ndarray:
    """(slot, 3) mass, friction, restitution; what the file leaves out is the scenario's constant."""
    values = read_array(path)
    if values.ndim != 2 or len(values) != scenario.num_slots or values.shape[1] not in (2, 3):
        raise BrokenExperimentError(f"confounders.npy has shape {values.shape}, not ({scenario.num_slots}, 2 or 3)")
    if values.shape[1] == 3:
        return values
    return np.column_stack([values, np.full(len(values), scenario.confounders.restitution[0])])


def _gravity_xy(path: Path, scenario: Scenario, *, trusted: bool) -> np.ndarray:
    """Horizontal gravity, m/s².

    It is read from gravity.txt if the task has it as a confounder (NaN if the file is missing or not trusted). Otherwise
    it is the scenario's constant.
    """
    if not TASKS[scenario.name].has_gravity:
        return np.array([scenario.confounders.gravity_x[0], scenario.confounders.gravity_y[0]], dtype=float)
    if not trusted or not path.exists():
        return np.full(2, np.nan)
    match = GRAVITY.search(read_text(path))
    try:
        return np.array([float(value) for value in match.groups()] if match else None, dtype=float).reshape(2)
    except ValueError as error:
        raise BrokenFileError(f"{path} is not 'gravity_x=… gravity_y=…'") from error


def _shapes(types: dict[int, str], scenario: Scenario) -> np.ndarray:
    shape = TASKS[scenario.name].shape
    if shape is not None:
        return np.full(scenario.num_slots, shape)
    unknown = [kind for kind in types.values() if kind not in SHAPES]
    if unknown or not types:
        raise BrokenExperimentError(f"ab/colors.txt does not say type={'|'.join(SHAPES)} of each object")
    shapes = np.zeros(scenario.num_slots, dtype=int)
    shapes[list(types)] = [SHAPES[kind] for kind in types.values()]
    return shapes


def _order(initial: np.ndarray, scenario: Scenario) -> np.ndarray:
    """(slot,) place of each object of A in the scenario's order."""
    key = np.where(initial.any(axis=-1), TASKS[scenario.name].place(initial), np.inf)
    return np.argsort(np.argsort(key, kind="stable"))
