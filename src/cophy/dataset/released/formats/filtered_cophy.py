"""Filtered-CoPhy (CoPhy_112), the successor's dataset: 25 Hz, objects in the order of COLORS.txt, masses alone."""

import ast
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cophy.dataset.released.formats.columns import clip_lengths, in_slots, read_states, slot_of
from cophy.dataset.released.recording import BrokenExperimentError, Recording
from cophy.dataset.released.untrusted_files import BrokenFileError, read_array, read_text
from cophy.dataset.splits import Split
from cophy.errors import CophyError
from cophy.scenario import Scenario, Shape

MAX_CHARACTERS = 1000  # of COLORS.txt
ENDINGS = (".txt", "")  # of lists of ids


@dataclass(frozen=True)
class FilteredTask:
    """The files of one task.

    folder: of the task. list_names: of a list of ids, any of them; count is the number of objects. shapes: of the objects
    in the order of COLORS.txt, or one for all. moving_first: whether the moving object comes first in our order.
    """

    folder: str
    list_names: tuple[str, ...]
    shapes: tuple[Shape, ...]
    moving_first: bool


TASKS = {
    "blocktower": FilteredTask("blocktowerCF", ("blocktowerCF_{count}_{part}",), (Shape.BOX,), moving_first=False),
    "balls": FilteredTask("ballsCF", ("ballsCF_{count}_{part}",), (Shape.SPHERE,), moving_first=False),
    "collision": FilteredTask(
        "collisionCF", ("collisionCF_{part}", "collision_{part}"), (Shape.CYLINDER, Shape.SPHERE), moving_first=True
    ),
}


class FilteredCoPhy:
    """Collision: the first object is the cylinder, the second the ball."""

    name = "filtered_cophy"
    frame_step = 5  # 25 Hz -> 5 Hz
    lists_by_shape = False

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        return root / TASKS[scenario.name].folder

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        if split.train.configurations is not None:
            raise CophyError(f"split={split.name}: Filtered-CoPhy has no lists of unseen confounder configurations")
        names = [name.format(count=num_objects, part=part) for name in TASKS[scenario.name].list_names]
        return [name + ending for name in names for ending in ENDINGS]

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        task, grid = TASKS[scenario.name], scenario.confounders
        slots = _colors(directory / "COLORS.txt", scenario)
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
        shape[slots] = _shapes(len(slots), task)
        states = np.stack([in_slots(columns, slots, scenario.num_slots) for columns in (ab, cd)])
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


def _colors(path: Path, scenario: Scenario) -> list[int]:
    """Slot of each object: the file is a Python list of names, read as a literal."""
    text = read_text(path)
    try:
        names = ast.literal_eval(text) if len(text) <= MAX_CHARACTERS else None
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError) as error:
        raise BrokenFileError(f"{path} is not a list of colours") from error
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise BrokenFileError(f"{path} is not a list of different colours")
    return [slot_of(name, scenario) for name in names]


def _shapes(count: int, task: FilteredTask) -> list[Shape]:
    if len(task.shapes) == 1:
        return list(task.shapes) * count
    if len(task.shapes) != count:
        named = " and ".join(shape.name.lower() for shape in task.shapes)
        raise BrokenExperimentError(f"COLORS.txt names {count} objects, not {named}")
    return list(task.shapes)
