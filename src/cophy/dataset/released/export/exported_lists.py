"""Lists of ids of an export: which experiments train, validate and test, for every kind of split that was released."""

import numpy as np

from cophy.dataset.released.formats.cophy_tasks import CoPhyTask
from cophy.dataset.splits import SPLITS, Part


def exported_lists(arrays: dict[str, np.ndarray], task: CoPhyTask, num_objects: int) -> dict[str, np.ndarray]:
    """Name of each list -> experiments.

    Args:
        arrays: of the dataset.
        task: whose kinds of lists are wanted.
        num_objects: in A of every experiment.
    """
    found = {}
    for kind in task.kinds:
        trained, tested = _parts(kind, num_objects)
        for split in SPLITS:
            part = tested if split == "test" else trained
            rows = part.select_split(arrays, split)
            found[task.list_of(split, num_objects, kind)] = np.flatnonzero(rows)
    return found


def as_text(rows: np.ndarray) -> bytes:
    """The content of a list."""
    return "".join(f"{row}\n" for row in rows.tolist()).encode()


def _parts(kind: str, num_objects: int) -> tuple[Part, Part]:
    """What is trained and what is tested on: `generalization` and `moving_*` test on what their training leaves out."""
    sphere, cylinder = (Part(num_objects, moving=shape) for shape in ("sphere", "cylinder"))
    seen, unseen = (Part(num_objects, configurations=which) for which in ("seen", "unseen"))
    everything = Part(num_objects)
    return {
        "normal": (everything, everything),
        "generalization": (seen, unseen),
        "moving_sphere": (sphere, cylinder),
        "moving_cylinder": (cylinder, sphere),
    }[kind]
