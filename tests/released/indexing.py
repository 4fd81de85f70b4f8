"""Indices of small released trees, written in this process."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cophy.dataset.experiment_set import ExperimentSet
from cophy.released.states import ReleasedSource
from tests.conftest import settings

LISTS = {"train": ["0", "1"], "val": ["2"], "test": ["3"]}


def states(source: str, scenario: str, root: Path, split: str | None = None, num_objects: int | None = None) -> Any:
    """Return an index in `<root>-data` that is not written yet."""
    config = _config(f"source={source}", f"scenario={scenario}", *([f"split={split}"] if split else []))
    (index,) = ReleasedSource(source, "", str(root)).experiment_sets(
        config.scenario,
        config.split,
        [num_objects or config.split.train.num_objects],
        root.with_name(f"{root.name}-data"),
    )
    return index


@cache
def _config(*overrides: str) -> Any:
    return settings("train", *overrides)


def make(opened: ExperimentSet) -> ExperimentSet:
    """Write the index in this process, and return it."""
    opened.directory.mkdir(parents=True, exist_ok=True)
    opened.write(opened.path(0), 0, lambda count: None)
    opened.write_manifest()
    return opened


def load(*args: Any, **kwargs: Any) -> dict[str, np.ndarray]:
    return make(states(*args, **kwargs)).load()
