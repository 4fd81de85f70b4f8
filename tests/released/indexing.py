"""Indices of small released trees, made in this process."""

from pathlib import Path
from typing import Any

import numpy as np

from cophy.dataset.experiment_set import ExperimentSet
from cophy.released.states import ReleasedSource
from tests.conftest import settings

LISTS = {"train": ["0", "1"], "val": ["2"], "test": ["3"]}


def states(source: str, scenario: str, root: Path, split: str | None = None, num_objects: int | None = None) -> Any:
    """An index in `<root>-data`, not yet made."""
    chosen = settings("train", f"source={source}", f"scenario={scenario}", *([f"split={split}"] if split else []))
    where = ReleasedSource(source, "", str(root))
    (found,) = where.experiment_sets(
        chosen.scenario,
        chosen.split,
        [num_objects or chosen.split.train.num_objects],
        size=chosen.size,
        data_seed=0,
        data_dir=root.with_name(f"{root.name}-data"),
    )
    return found


def make(opened: ExperimentSet) -> ExperimentSet:
    """The index, made in this process."""
    opened.directory.mkdir(parents=True, exist_ok=True)
    opened.write(opened.path(0), 0, lambda count: None)
    opened.write_manifest()
    return opened


def load(*args: Any, **kwargs: Any) -> dict[str, np.ndarray]:
    return make(states(*args, **kwargs)).load()
