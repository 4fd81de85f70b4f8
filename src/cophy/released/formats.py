"""The released formats.

`CoPhy` reads CoPhy_224, the paper's released dataset, and what its released tower generator writes. `FilteredCoPhy` reads
CoPhy_112 of Filtered-CoPhy, the successor: 25 Hz, objects in the order of COLORS.txt, masses only. TASKS holds facts about
the released files, by the name of our scenario.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cophy.dataset.splits import Split
from cophy.dataset.states import CONFOUNDERS_OF_OBJECTS
from cophy.errors import CophyError
from cophy.released.recording import Recording
from cophy.scenario import Scenario, Shape
from cophy.untrusted_files import BrokenFileError, count_frames, read_array, read_text

SEQUENCE_FOLDERS = ("ab", "cd")  # folders of an experiment


@dataclass(frozen=True)
class ReleasedTask:
    """The files of one task of CoPhy_224. Filtered-CoPhy has the same folders and shapes.

    Attributes:
        folder: folder of the task.
        shape: shape of all objects; None where colors.txt names the shape of each.
        place: maps states (slot, 13) in the first frame of AB to a key (slot,) that sorts the objects into their order.
        has_counts: whether folders (in CoPhy_224) and lists of ids are named after the number of objects.
        kinds: kinds of lists that were released, see `kind_of`; names of lists contain the kind if there are several.
        max_frames: longest sequence that the released loader reads, None for any.
        confounders: columns of confounders.npy.
        has_gravity: whether gravity.txt holds a confounder; otherwise explanations.txt describes the do-operation.
        colors_header: first line of colors.txt.
    """

    folder: str
    shape: Shape | None
    place: Callable[[np.ndarray], np.ndarray]
    has_counts: bool = True
    kinds: tuple[str, ...] = ("normal",)
    max_frames: int | None = None
    confounders: tuple[str, ...] = CONFOUNDERS_OF_OBJECTS
    has_gravity: bool = False
    colors_header: str = ""

    def directory(self, root: Path, num_objects: int) -> Path:
        """Return the folder of CoPhy_224 whose subfolders are the experiments."""
        return root / self.folder / str(num_objects) if self.has_counts else root / self.folder

    def list_of(self, part: str, num_objects: int, kind: str) -> str:
        """Return the name of a list of ids of CoPhy_224. part: train, val or test; kind: see `kind_of`."""
        count = f"_{num_objects}" if self.has_counts else ""
        return f"{self.folder}_{part}{count}{f'_{kind}' if len(self.kinds) > 1 else ''}.txt"


TASKS = {
    "blocktower": ReleasedTask(
        "blocktowerCF",
        Shape.BOX,
        place=lambda states: states[:, 2],  # by height
        kinds=("normal", "generalization"),
        confounders=("mass", "friction"),
        has_gravity=True,
        colors_header="from bottom to top\n",
    ),
    "balls": ReleasedTask("ballsCF", Shape.SPHERE, place=lambda states: np.arange(len(states))),  # by slot
    "collision": ReleasedTask(
        "collisionCF",
        None,
        place=lambda states: -np.linalg.norm(states[:, 7:10], axis=-1),  # the moving object first
        has_counts=False,
        kinds=("normal", "moving_sphere", "moving_cylinder"),
        max_frames=15,
    ),
}


def kind_of(split: Split) -> str:
    """Return the kind of released lists that a split uses: moving_sphere lists train on moving spheres.

    Raises:
        CophyError: there are no such lists.
    """
    if split.test.configurations == "seen":
        raise CophyError(f"split={split.name}: CoPhy_224 has no test list of seen confounder configurations")
    if split.train.configurations is not None:
        return "generalization"
    return f"moving_{split.train.moving}" if split.train.moving else "normal"


def _read_states(directory: Path, scenario: Scenario, frame_step: int) -> list[np.ndarray]:
    """Read states of AB and of CD at the scenario's frames, each (T, column, 13), as columns of states.npy."""
    sequences, length = [], scenario.clock.num_frames * frame_step
    for name in SEQUENCE_FOLDERS:
        states = read_array(directory / name / "states.npy")
        if states.ndim != 3 or states.shape[2] != 13:
            raise BrokenFileError(f"states.npy has shape {states.shape}, not (time, object, 13)")
        if len(states) != length:
            raise BrokenFileError(f"states.npy has {len(states)} frames, not {length}")
        sequences.append(states[::frame_step])
    return sequences


def _move_to_slots(columns: np.ndarray, slots: list[int], num_slots: int) -> np.ndarray:
    """Move columns (T, column, 13) to the slots of their objects: (T, slot, 13), zero where there is no object."""
    states = np.zeros((len(columns), num_slots, 13))
    states[:, slots[: columns.shape[1]]] = columns
    return states


def _slot_of(color: str, scenario: Scenario) -> int:
    if color not in scenario.colors:
        raise BrokenFileError(f"colour {color[:20]!r} is not among {', '.join(scenario.colors)}")
    return list(scenario.colors).index(color)


def _has_clips(directory: Path, scenario: Scenario, frame_step: int) -> list[bool]:
    """Return whether AB and CD have RGB clips. Clips of another length are refused."""
    counts, expected = [], scenario.clock.num_frames * frame_step
    for name in SEQUENCE_FOLDERS:
        counts.append(count_frames(directory / name / "rgb.mp4"))
        if counts[-1] not in (0, expected):
            raise BrokenFileError(f"{name}/rgb.mp4 has {counts[-1]} frames, not {expected}")
    return [count > 0 for count in counts]


def _order(initial: np.ndarray, task: ReleasedTask) -> np.ndarray:
    """Return the place of each object of A in the scenario's order, (slot,)."""
    key = np.where(initial.any(axis=-1), task.place(initial), np.inf)
    return np.argsort(np.argsort(key, kind="stable"))


SHAPES_BY_TYPE = {"sphere": Shape.SPHERE, "cylinder_up": Shape.CYLINDER, "cylinder_down": Shape.CYLINDER}
COLOR = re.compile(r"(?:type=(\w+)\s+)?color=(\w+)")
GRAVITY = re.compile(r"gravity_x=(\S+)\s+gravity_y=(\S+)")


class CoPhy:
    """CoPhy_224: 5 Hz, states by colour slot.

    The released tower generator writes states from bottom to top, and no colors.txt, so that it is unknown which mass belongs
    to which block; its gravity.txt holds frictions. Confounders of blocks and gravity are then NaN.

    Attributes:
        name: value of `source=`.
        frame_step: number of states, and frames of a clip, per frame that is read.
        lists_by_shape: whether splits by the moving object's shape have lists of their own.
    """

    name = "cophy"
    frame_step = 1
    lists_by_shape = True

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        """Return the folder whose subfolders are the experiments, below the root of the released dataset."""
        return TASKS[scenario.name].directory(root, num_objects)

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        """Return the names that a list of ids may have. part: train, val or test.

        Raises:
            CophyError: the format has no lists for this split.
        """
        return [TASKS[scenario.name].list_of(part, num_objects, kind_of(split))]

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        """Read one experiment.

        Raises:
            BrokenFileError: a file is not what the format says, or the files contradict each other or the scenario.
        """
        ab, cd = _read_states(directory, scenario, self.frame_step)
        types = _types_by_slot(directory / "ab" / "colors.txt", scenario)
        confounders = _read_confounders(directory / "confounders.npy", scenario)
        padded = ab.shape[1] == scenario.num_slots and not _is_stacked(ab[0], list(types))  # a column per slot
        if cd.shape[1] > ab.shape[1] or (padded and cd.shape[1] != ab.shape[1]):
            raise BrokenFileError(f"states.npy of AB have {ab.shape[1]} objects, of CD {cd.shape[1]}")
        if padded:
            slots = remaining = list(range(scenario.num_slots))
        else:  # a column per object
            slots = list(types) or np.flatnonzero(confounders[:, 0] > 0).tolist()  # without colors.txt in unknown order
            if len(slots) != ab.shape[1]:
                source = "colors.txt" if types else "confounders.npy"
                raise BrokenFileError(f"states.npy has {ab.shape[1]} objects, {source} {len(slots)}")
            remaining = _remaining_slots(directory / "cd" / "colors.txt", slots, cd.shape[1], scenario)
        states = np.stack([_move_to_slots(*each, scenario.num_slots) for each in ((ab, slots), (cd, remaining))])
        if not types and ab[0].any(axis=-1).all():
            confounders = np.full_like(confounders, np.nan)
        return Recording(
            states=states,
            shape=_shapes(types, scenario),
            order=_order(states[0, 0], TASKS[scenario.name]),
            confounders=confounders,
            gravity_xy=_read_gravity(directory / "gravity.txt", scenario, trusted=bool(types)),
            has_clips=_has_clips(directory, scenario, self.frame_step),
        )


def _types_by_slot(path: Path, scenario: Scenario) -> dict[int, str]:
    """Return slot -> type (or "") in the order of colors.txt, towers from bottom to top; empty where there is no file."""
    if not os.path.lexists(path):
        return {}
    matches = [match for line in read_text(path).splitlines() if (match := COLOR.search(line))]
    return {_slot_of(match[2], scenario): match[1] or "" for match in matches}


def _is_stacked(initial: np.ndarray, slots: list[int]) -> bool:
    """Return whether a file with one column per slot lists the blocks from bottom to top instead of by slot.

    A tower may fit both readings.
    """
    height = initial[:, 2]
    if not initial.any(axis=-1).all() or (np.diff(height) <= 0).any():
        return False
    return not slots or bool((np.diff(height[slots]) <= 0).any())


def _remaining_slots(path: Path, slots: list[int], num_columns: int, scenario: Scenario) -> list[int]:
    """Return the slot of each column of CD, as listed in its colors.txt; otherwise the top block was removed."""
    listed = list(_types_by_slot(path, scenario))
    if len(listed) != num_columns:
        return slots
    if unknown := sorted(set(listed) - set(slots)):
        raise BrokenFileError(f"cd/colors.txt lists {list(scenario.colors)[unknown[0]]}, which is not in AB")
    return listed


def _read_confounders(path: Path, scenario: Scenario) -> np.ndarray:
    """Return mass, friction, restitution, (slot, 3); a missing restitution is the scenario's constant."""
    values = read_array(path)
    if values.ndim != 2 or len(values) != scenario.num_slots or values.shape[1] not in (2, 3):
        raise BrokenFileError(f"confounders.npy has shape {values.shape}, not ({scenario.num_slots}, 2 or 3)")
    if values.shape[1] == 3:
        return values
    return np.column_stack([values, np.full(len(values), scenario.confounders.restitution[0])])


def _read_gravity(path: Path, scenario: Scenario, *, trusted: bool) -> np.ndarray:
    """Return horizontal gravity, m/s²: from gravity.txt where it is a confounder (NaN if missing or not trusted)."""
    if not TASKS[scenario.name].has_gravity:
        return np.array([scenario.confounders.gravity_x[0], scenario.confounders.gravity_y[0]], dtype=float)
    if not trusted or not path.exists():
        return np.full(2, np.nan)
    match = GRAVITY.search(read_text(path))
    try:
        return np.array(match.groups() if match else [], dtype=float).reshape(2)
    except ValueError as error:
        raise BrokenFileError(f"{path} is not 'gravity_x=… gravity_y=…'") from error


def _shapes(types: dict[int, str], scenario: Scenario) -> np.ndarray:
    shape = TASKS[scenario.name].shape
    if shape is not None:
        return np.full(scenario.num_slots, shape)
    if not types or not set(types.values()) <= set(SHAPES_BY_TYPE):
        raise BrokenFileError(f"ab/colors.txt does not name type={'|'.join(SHAPES_BY_TYPE)} of each object")
    shapes = np.zeros(scenario.num_slots, dtype=int)
    shapes[list(types)] = [SHAPES_BY_TYPE[kind] for kind in types.values()]
    return shapes


class FilteredCoPhy:
    """CoPhy_112: 25 Hz, objects in the order of COLORS.txt. In collisions the first is the cylinder, the second the ball.

    Attributes and methods are those of `CoPhy`.
    """

    name = "filtered_cophy"
    frame_step = 5  # 25 Hz -> 5 Hz
    lists_by_shape = False

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        return root / TASKS[scenario.name].folder

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        if split.train.configurations is not None:
            raise CophyError(f"split={split.name}: Filtered-CoPhy has no lists of unseen confounder configurations")
        task = TASKS[scenario.name]
        names = [f"{task.folder}_{num_objects}_{part}"]
        if not task.has_counts:
            names = [f"{task.folder}_{part}", f"{scenario.name}_{part}"]
        return [name + ending for name in names for ending in (".txt", "")]

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        task, grid = TASKS[scenario.name], scenario.confounders
        slots = _read_colors(directory / "COLORS.txt", scenario)
        ab, cd = _read_states(directory, scenario, self.frame_step)
        masses = read_array(directory / "confounders.npy").reshape(-1)
        shapes = [Shape.CYLINDER, Shape.SPHERE] if task.shape is None else [task.shape] * len(slots)
        counts = {"AB": ab.shape[1], "CD": cd.shape[1], "confounders.npy": len(masses), "the task": len(shapes)}
        for name, count in counts.items():
            if count != len(slots):
                raise BrokenFileError(f"COLORS.txt names {len(slots)} objects, {name} has {count}")
        order, shape, mass = np.zeros((3, scenario.num_slots))
        order[slots], shape[slots], mass[slots] = np.arange(len(slots)), shapes, masses
        constants = np.tile([grid.friction[0], grid.restitution[0]], (scenario.num_slots, 1))
        states = np.stack([_move_to_slots(columns, slots, scenario.num_slots) for columns in (ab, cd)])
        return Recording(
            states=states,
            shape=shape,
            order=_order(states[0, 0], task) if task.shape is None else order,
            confounders=np.column_stack([mass, constants]),
            gravity_xy=np.array([grid.gravity_x[0], grid.gravity_y[0]], dtype=float),
            has_clips=_has_clips(directory, scenario, self.frame_step),
        )


def _read_colors(path: Path, scenario: Scenario) -> list[int]:
    """Return the slot of each object: the file is a Python list of names in quotes."""
    names = re.findall(r"'(\w+)'", read_text(path).replace('"', "'"))
    if not names or len(set(names)) < len(names):
        raise BrokenFileError(f"{path} is not a list of different colours")
    return [_slot_of(name, scenario) for name in names]


ReleasedFormat = CoPhy | FilteredCoPhy
FORMATS: dict[str, ReleasedFormat] = {known.name: known for known in (CoPhy(), FilteredCoPhy())}
