"""Filtered-CoPhy (CoPhy_112), the successor's dataset: 25 Hz, objects in the order of COLORS.txt, masses alone."""

import ast
from pathlib import Path

import numpy as np

from cophy.dataset.external.files import BrokenFileError, count_frames, read_array, read_text
from cophy.dataset.external.layout import TASKS, clip_frames, in_slots, sampled, slot_of
from cophy.dataset.external.recording import BrokenExperimentError, Recording
from cophy.dataset.splits import Split
from cophy.errors import CophyError
from cophy.scenario import Scenario, Shape

LONGEST_LIST = 1000  # characters of COLORS.txt


class FilteredCoPhy:
    """Collision: the first object is the cylinder, the second the ball."""

    name = "filtered_cophy"
    frame_step = 5  # 25 Hz -> 5 Hz
    lists_by_shape = False

    def directory(self, root: Path, scenario: Scenario, num_objects: int) -> Path:
        return root / TASKS[scenario.name]

    def list_names(self, scenario: Scenario, num_objects: int, split: Split, part: str) -> list[str]:
        if split.train.configurations is not None:
            raise CophyError(f"split={split.name}: Filtered-CoPhy has no lists of unseen confounder configurations")
        task = TASKS[scenario.name]
        names = (
            [f"{task}_{part}", f"collision_{part}"]
            if scenario.name == "collision"
            else [f"{task}_{num_objects}_{part}"]
        )
        return [name + ending for name in names for ending in (".txt", "")]

    def read(self, directory: Path, scenario: Scenario) -> Recording:
        slots = _colors(directory / "COLORS.txt", scenario)
        ab, cd = (sampled(read_array(directory / s / "states.npy"), scenario, self.frame_step) for s in ("ab", "cd"))
        if {ab.shape[1], cd.shape[1]} != {len(slots)}:
            raise BrokenExperimentError(
                f"states.npy have {ab.shape[1]} and {cd.shape[1]} objects, COLORS.txt {len(slots)}"
            )
        masses = read_array(directory / "confounders.npy").reshape(-1)
        if len(masses) != len(slots):
            raise BrokenExperimentError(f"confounders.npy has {len(masses)} masses, COLORS.txt {len(slots)} objects")
        mass, order, shape = (np.zeros(scenario.num_slots) for _ in range(3))
        mass[slots], order[slots] = masses, np.arange(len(slots))
        shape[slots] = _shapes(len(slots), scenario)
        states = np.stack([in_slots(columns, slots, scenario.num_slots) for columns in (ab, cd)])
        if scenario.name == "collision":
            order = np.where(np.linalg.norm(states[0, 0, :, 7:10], axis=-1) > 0, 0.0, 1.0)
        counts = tuple(count_frames(directory / s / "rgb.mp4") for s in ("ab", "cd"))
        grid = scenario.confounders
        return Recording(
            states=states,
            shape=shape,
            order=order,
            mass=mass,
            friction=np.full(scenario.num_slots, grid.friction[0], dtype=float),
            restitution=np.full(scenario.num_slots, grid.restitution[0], dtype=float),
            gravity_xy=np.array([grid.gravity_x[0], grid.gravity_y[0]], dtype=float),
            clip_frames=clip_frames((counts[0], counts[1]), scenario, self.frame_step),
        )


def _colors(path: Path, scenario: Scenario) -> list[int]:
    """Slot of each object: the file is a Python list of names, read as a literal."""
    text = read_text(path)
    try:
        names = ast.literal_eval(text) if len(text) <= LONGEST_LIST else None
    except (ValueError, SyntaxError, MemoryError, RecursionError) as error:
        raise BrokenFileError(f"{path} is not a list of colours") from error
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise BrokenFileError(f"{path} is not a list of different colours")
    return [slot_of(name, scenario) for name in names]


def _shapes(count: int, scenario: Scenario) -> list[int]:
    if scenario.name == "collision":
        if count != 2:
            raise BrokenExperimentError(f"COLORS.txt names {count} objects, not a cylinder and a ball")
        return [Shape.CYLINDER, Shape.SPHERE]
    return [Shape.SPHERE if scenario.name == "balls" else Shape.BOX] * count
