"""What differs between the three tasks of CoPhy_224: facts about the released files, by the name of our scenario."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cophy.dataset.splits import Split
from cophy.errors import CophyError
from cophy.scenario import Shape


@dataclass(frozen=True)
class CoPhyTask:
    """The files of one task.

    folder: of the task. has_folder_per_count: whether experiments with one number of objects have a folder of their own.
    list_name: of a list of ids; count is the number of objects, kind one of `kinds` (see `kind_of`).
    max_frames: longest sequence that its loader knows, None for any. confounders: columns of confounders.npy that are
    released. has_gravity: whether gravity.txt holds a confounder; else explanations.txt tells the do-operation.
    colors_header: first line of colors.txt. shape: of all objects; None where colors.txt says it of each.
    place: from states (slot, 13) in the first frame of AB to a key (slot,) that sorts the objects into their order.
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
        """The folder whose subfolders are the experiments."""
        folder = root / self.folder
        return folder / str(num_objects) if self.has_folder_per_count else folder

    def list_of(self, part: str, num_objects: int, kind: str) -> str:
        """Name of a list of ids.

        Args:
            part: train, val or test.
            num_objects: in A.
            kind: see `kind_of`.
        """
        return self.list_name.format(folder=self.folder, part=part, count=num_objects, kind=kind)


def kind_of(split: Split) -> str:
    """Which of the released lists a split is: moving_sphere are those that are trained on moving spheres.

    Raises:
        CophyError: it is none of them.
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
