"""The released formats.

`CoPhy` reads CoPhy_224, the paper's released dataset, and what its released tower generator writes. `FilteredCoPhy` reads
CoPhy_112 of Filtered-CoPhy, the successor: 25 Hz, objects in the order of COLORS.txt, masses only. TASKS and FILTERED_TASKS
hold facts about the released files, by the name of our scenario.
"""

import ast
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cophy.dataset.splits import Split
from cophy.errors import CophyError
from cophy.released.recording import BrokenExperimentError, Recording, ReleasedFormat
from cophy.scenario import Scenario, Shape
from cophy.untrusted_files import BrokenFileError, count_frames, read_array, read_text

SEQUENCES = ("ab", "cd")  # folders of an experiment


def read_states(directory: Path, scenario: Scenario, frame_step: int) -> tuple[np.ndarray, np.ndarray]:
    """Read states of AB and of CD at the scenario's frames, each (T, column, 13), as columns of states.npy.

    Raises:
        BrokenExperimentError: a file has another shape.
    """
    ab, cd = (_sample(read_array(directory / name / "states.npy"), scenario, frame_step) for name in SEQUENCES)
    return ab, cd


def move_to_slots(columns: np.ndarray, slots: list[int], num_slots: int) -> np.ndarray:
    """Move columns (T, column, 13) to the slots of their objects: (T, slot, 13), zero where there is no object."""
    states = np.zeros((len(columns), num_slots, 13))
    states[:, slots[: columns.shape[1]]] = columns
    return states


def slot_of(color: str, scenario: Scenario) -> int:
    """Return the slot of a colour."""
    if color not in scenario.colors:
        raise BrokenExperimentError(f"colour {color[:20]!r} is not among {', '.join(scenario.colors)}")
    return list(scenario.colors).index(color)


def clip_lengths(directory: Path, scenario: Scenario, frame_step: int) -> tuple[int, int]:
    """Return the number of frames of the RGB clips of AB and of CD, 0 where there is no clip.

    Raises:
        BrokenExperimentError: a clip has another length.
    """
    expected = scenario.clock.num_frames * frame_step
    counts = [count_frames(directory / name / "rgb.mp4") for name in SEQUENCES]
    for name, count in zip(SEQUENCES, counts, strict=True):
        if count not in (0, expected):
            raise BrokenExperimentError(f"{name}/rgb.mp4 has {count} frames, not {expected}")
    return counts[0], counts[1]


def _sample(states: np.ndarray, scenario: Scenario, frame_step: int) -> np.ndarray:
    """Return the states at the scenario's frames: (T · frame_step, column, 13) -> (T, column, 13)."""
    length = scenario.clock.num_frames * frame_step
    if states.ndim != 3 or states.shape[2] != 13:
        raise BrokenExperimentError(f"states.npy has shape {states.shape}, not (time, object, 13)")
    if len(states) != length:
        raise BrokenExperimentError(f"states.npy has {len(states)} frames, not {length}")
    return states[::frame_step]


@dataclass(frozen=True)
class CoPhyTask:
    """The files of one task of CoPhy_224.

    Attributes:
        folder: folder of the task.
        has_folder_per_count: whether each number of objects has a folder of its own.
        list_name: name of a list of ids; count is the number of objects, kind one of `kinds` (see `kind_of`).
        kinds: kinds of lists that were released.
        max_frames: longest sequence that the released loader reads, None for any.
        confounders: columns of confounders.npy.
        has_gravity: whether gravity.txt holds a confounder; otherwise explanations.txt describes the do-operation.
        colors_header: first line of colors.txt.
        shape: shape of all objects; None where colors.txt names the shape of each.
        place: maps states (slot, 13) in the first frame of AB to a key (slot,) that sorts the objects into their order.
    """

    folder: str
    has_folder_per_count: bool
    list_name: str
    kinds: tuple[str, ...]
    max_frames: int | None
    confounders: tuple[str, ...]
    has_gravity: bool
    colors_header: str
    shape: Shape | None
    place: Callable[[np.ndarray], np.ndarray]

    def directory(self, root: Path, num_objects: int) -> Path:
        """Return the folder whose subfolders are the experiments."""
        folder = root / self.folder
        return folder / str(num_objects) if self.has_folder_per_count else folder

    def list_of(self, part: str, num_objects: int, kind: str) -> str:
        """Return the name of a list of ids. part: train, val or test; kind: see `kind_of`."""
        return self.list_name.format(folder=self.folder, part=part, count=num_objects, kind=kind)


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


def _height(states: np.ndarray) -> np.ndarray:
    return states[:, 2]


def _slot(states: np.ndarray) -> np.ndarray:
    return np.arange(len(states))


def _slowness(states: np.ndarray) -> np.ndarray:
    return -np.linalg.norm(states[:, 7:10], axis=-1)


TASKS = {
    "blocktower": CoPhyTask(
        folder="blocktowerCF",
        has_folder_per_count=True,
        list_name="{folder}_{part}_{count}_{kind}.txt",
        kinds=("normal", "generalization"),
        max_frames=None,
        confounders=("mass", "friction"),
        has_gravity=True,
        colors_header="from bottom to top\n",
        shape=Shape.BOX,
        place=_height,
    ),
    "balls": CoPhyTask(
        folder="ballsCF",
        has_folder_per_count=True,
        list_name="{folder}_{part}_{count}.txt",
        kinds=("normal",),
        max_frames=None,
        confounders=("mass", "friction", "restitution"),
        has_gravity=False,
        colors_header="",
        shape=Shape.SPHERE,
        place=_slot,
    ),
    "collision": CoPhyTask(
        folder="collisionCF",
        has_folder_per_count=False,
        list_name="{folder}_{part}_{kind}.txt",
        kinds=("normal", "moving_sphere", "moving_cylinder"),
        max_frames=15,
        confounders=("mass", "friction", "restitution"),
        has_gravity=False,
        colors_header="",
        shape=None,
        place=_slowness,
    ),
}


SHAPES_BY_TYPE = {"sphere": Shape.SPHERE, "cylinder_up": Shape.CYLINDER, "cylinder_down": Shape.CYLINDER}
COLOR = re.compile(r"(?:type=(\w+)\s+)?color=(\w+)")
GRAVITY = re.compile(r"gravity_x=(\S+)\s+gravity_y=(\S+)")


class CoPhy:
    """CoPhy_224: 5 Hz, states by colour slot.

    The released tower generator writes states from bottom to top, and no colors.txt, so that it is unknown which mass belongs
    to which block; its gravity.txt holds frictions. Confounders of blocks and gravity are then NaN.
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
        values = _read_confounders(directory / "confounders.npy", scenario)
        padded = _is_padded(ab, list(types), scenario.num_slots)
        if cd.shape[1] > ab.shape[1] or (padded and cd.shape[1] != ab.shape[1]):
            raise BrokenExperimentError(f"states.npy of AB have {ab.shape[1]} objects, of CD {cd.shape[1]}")
        slots = list(range(scenario.num_slots)) if padded else _slots(ab, list(types), values)
        remaining = slots if padded else _remaining_slots(directory / "cd" / "colors.txt", slots, cd.shape[1], scenario)
        states = np.stack([move_to_slots(*each, scenario.num_slots) for each in ((ab, slots), (cd, remaining))])
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
            gravity_xy=_read_gravity(directory / "gravity.txt", scenario, trusted=bool(types)),
            clip_frames=clip_lengths(directory, scenario, self.frame_step),
        )


def _types_by_slot(path: Path, scenario: Scenario) -> dict[int, str]:
    """Return slot -> type (or "") in the order of colors.txt, towers from bottom to top; empty where there is no file."""
    if not path.exists() and not path.is_symlink():
        return {}
    matches = [match for line in read_text(path).splitlines() if (match := COLOR.search(line))]
    return {slot_of(match[2], scenario): match[1] or "" for match in matches}


def _is_padded(ab: np.ndarray, slots: list[int], num_slots: int) -> bool:
    """Return whether states.npy has one column per slot, empty slots included. Otherwise it has one per object."""
    return ab.shape[1] == num_slots and not _stacked_by_column(ab, slots)


def _stacked_by_column(ab: np.ndarray, slots: list[int]) -> bool:
    """Return whether a file with one column per slot lists the blocks from bottom to top instead of by slot.

    A tower may fit both readings.
    """
    height = ab[0, :, 2]
    if not ab[0].any(axis=-1).all() or (np.diff(height) <= 0).any():
        return False
    return not slots or bool((np.diff(height[slots]) <= 0).any())


def _slots(ab: np.ndarray, listed: list[int], values: np.ndarray) -> list[int]:
    """Return the slot of each column, as listed in colors.txt; without it, the slots that have a mass, in unknown order."""
    slots, source = (listed, "colors.txt") if listed else (np.flatnonzero(values[:, 0] > 0).tolist(), "confounders.npy")
    if len(slots) != ab.shape[1]:
        raise BrokenExperimentError(f"states.npy has {ab.shape[1]} objects, {source} {len(slots)}")
    return slots


def _remaining_slots(path: Path, slots: list[int], num_columns: int, scenario: Scenario) -> list[int]:
    """Return the slot of each column of CD, as listed in its colors.txt; otherwise the top block was removed."""
    listed = list(_types_by_slot(path, scenario))
    if len(listed) != num_columns:
        return slots
    if unknown := sorted(set(listed) - set(slots)):
        raise BrokenExperimentError(f"cd/colors.txt lists {list(scenario.colors)[unknown[0]]}, which is not in AB")
    return listed


def _read_confounders(path: Path, scenario: Scenario) -> np.ndarray:
    """Return mass, friction, restitution, (slot, 3); a missing restitution is the scenario's constant."""
    values = read_array(path)
    if values.ndim != 2 or len(values) != scenario.num_slots or values.shape[1] not in (2, 3):
        raise BrokenExperimentError(f"confounders.npy has shape {values.shape}, not ({scenario.num_slots}, 2 or 3)")
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
        return np.array([float(value) for value in match.groups()] if match else None, dtype=float).reshape(2)
    except ValueError as error:
        raise BrokenFileError(f"{path} is not 'gravity_x=… gravity_y=…'") from error


def _shapes(types: dict[int, str], scenario: Scenario) -> np.ndarray:
    shape = TASKS[scenario.name].shape
    if shape is not None:
        return np.full(scenario.num_slots, shape)
    unknown = [kind for kind in types.values() if kind not in SHAPES_BY_TYPE]
    if unknown or not types:
        raise BrokenExperimentError(f"ab/colors.txt does not name type={'|'.join(SHAPES_BY_TYPE)} of each object")
    shapes = np.zeros(scenario.num_slots, dtype=int)
    shapes[list(types)] = [SHAPES_BY_TYPE[kind] for kind in types.values()]
    return shapes


def _order(initial: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Return the place of each object of A in the scenario's order, (slot,)."""
    key = np.where(initial.any(axis=-1), TASKS[scenario.name].place(initial), np.inf)
    return np.argsort(np.argsort(key, kind="stable"))


MAX_COLORS_CHARACTERS = 1000  # length of COLORS.txt
ENDINGS = (".txt", "")  # endings of lists of ids


@dataclass(frozen=True)
class FilteredTask:
    """The files of one task of Filtered-CoPhy.

    Attributes:
        folder: folder of the task.
        list_names: names that a list of ids may have; count is the number of objects.
        shapes: shapes of the objects in the order of COLORS.txt, or one for all.
        moving_first: whether the moving object comes first in our order.
    """

    folder: str
    list_names: tuple[str, ...]
    shapes: tuple[Shape, ...]
    moving_first: bool


FILTERED_TASKS = {
    "blocktower": FilteredTask("blocktowerCF", ("blocktowerCF_{count}_{part}",), (Shape.BOX,), moving_first=False),
    "balls": FilteredTask("ballsCF", ("ballsCF_{count}_{part}",), (Shape.SPHERE,), moving_first=False),
    "collision": FilteredTask(
        "collisionCF", ("collisionCF_{part}", "collision_{part}"), (Shape.CYLINDER, Shape.SPHERE), moving_first=True
    ),
}


class FilteredCoPhy:
    """CoPhy_112: 25 Hz, objects in the order of COLORS.txt. In collisions the first is the cylinder, the second the ball."""

    name = "filtered_cophy"
    frame_step = 5  # 25 Hz -> 5 Hz
    lists_by_shape = False

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        return root / FILTERED_TASKS[scenario.name].folder

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        if split.train.configurations is not None:
            raise CophyError(f"split={split.name}: Filtered-CoPhy has no lists of unseen confounder configurations")
        names = [name.format(count=num_objects, part=part) for name in FILTERED_TASKS[scenario.name].list_names]
        return [name + ending for name in names for ending in ENDINGS]

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        task, grid = FILTERED_TASKS[scenario.name], scenario.confounders
        slots = _read_colors(directory / "COLORS.txt", scenario)
        ab, cd = read_states(directory, scenario, self.frame_step)
        if {ab.shape[1], cd.shape[1]} != {len(slots)}:
            raise BrokenExperimentError(
                f"states.npy have {ab.shape[1]} and {cd.shape[1]} objects, COLORS.txt {len(slots)}"
            )
        masses = read_array(directory / "confounders.npy").reshape(-1)
        if len(masses) != len(slots):
            raise BrokenExperimentError(f"confounders.npy has {len(masses)} masses, COLORS.txt {len(slots)} objects")
        mass, order, shape = (np.zeros(scenario.num_slots) for _ in range(3))
        mass[slots], order[slots] = masses, np.arange(len(slots))
        shape[slots] = _filtered_shapes(len(slots), task)
        states = np.stack([move_to_slots(columns, slots, scenario.num_slots) for columns in (ab, cd)])
        if task.moving_first:
            order = np.where(np.linalg.norm(states[0, 0, :, 7:10], axis=-1) > 0, 0.0, 1.0)
        return Recording(
            states=states,
            shape=shape,
            order=order,
            mass=mass,
            friction=np.full(scenario.num_slots, grid.friction[0], dtype=float),
            restitution=np.full(scenario.num_slots, grid.restitution[0], dtype=float),
            gravity_xy=np.array([grid.gravity_x[0], grid.gravity_y[0]], dtype=float),
            clip_frames=clip_lengths(directory, scenario, self.frame_step),
        )


def _read_colors(path: Path, scenario: Scenario) -> list[int]:
    """Return the slot of each object: the file is a Python list of names, read as a literal."""
    text = read_text(path)
    try:
        names = ast.literal_eval(text) if len(text) <= MAX_COLORS_CHARACTERS else None
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError) as error:
        raise BrokenFileError(f"{path} is not a list of colours") from error
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise BrokenFileError(f"{path} is not a list of different colours")
    return [slot_of(name, scenario) for name in names]


def _filtered_shapes(count: int, task: FilteredTask) -> list[Shape]:
    if len(task.shapes) == 1:
        return list(task.shapes) * count
    if len(task.shapes) != count:
        named = " and ".join(shape.name.lower() for shape in task.shapes)
        raise BrokenExperimentError(f"COLORS.txt names {count} objects, not {named}")
    return list(task.shapes)


FORMATS: dict[str, ReleasedFormat] = {known.name: known for known in (CoPhy(), FilteredCoPhy())}
