"""Stored towers as statics sees them: blocks from the ground up.

The simulated part of a generated dataset: states, confounders, do-operation and split of every experiment.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cophy.dataset.cards import write_card
from cophy.dataset.experiment_set import ALL, ExperimentSet, NeededFrames
from cophy.dataset.fields import experiment_fields, to_arrays
from cophy.dataset.images import Images
from cophy.dataset.shards import DamagedShardError, Fields, encode, read_format
from cophy.dataset.spec import FORMAT_VERSION, DatasetSpec
from cophy.dataset.splits import SPLITS
from cophy.scenario import Experiment, Shape, Simulator
from cophy.scenario.rendering import RenderSettings


class States(ExperimentSet):
    """A generated dataset, in its own directory."""

    spec: DatasetSpec

    def __init__(self, spec: DatasetSpec, data_dir: Path) -> None:
        directory = spec.directory(data_dir)
        title = f"{spec.scenario.name}, {spec.num_objects} objects"
        super().__init__(spec, directory, title=title, script="generate", keys=spec.command_line_keys(directory))

    @property
    def id(self) -> str:
        return self.spec.id

    @property
    def remedy(self) -> str:
        return "take a larger size="

    def frames(self, render: RenderSettings, needed: NeededFrames = ALL) -> Images:
        return Images(self, render, needed)

    def unseen_by(
        self, *, num_experiments: dict[str, dict[str, int]], data_seed: int, trained_on: Sequence[str]
    ) -> bool:
        return (num_experiments, data_seed) == (self.spec.size.num_experiments, self.spec.data_seed)

    @property
    def why_slow(self) -> str:
        return "; settings of one's own (min_difference, min_effect, ranges, sizes) may leave no experiment to be found"

    def remarks(self) -> list[str]:
        beside = self.directory.parent.glob(f"{self.spec.num_objects}-{self.spec.size.name}-*")
        formats = {directory: read_format(directory) for directory in sorted(beside)}
        return [
            f"{directory} is of format {found}, this version of cophy makes and reads format {FORMAT_VERSION}: delete "
            "it, or use it with the version that made it, which its manifest.json names"
            for directory, found in formats.items()
            if found not in (None, FORMAT_VERSION)
        ]

    def fields(self, shard: int) -> Fields:
        return experiment_fields(self.spec, len(self.spec.experiments_of_shard(shard)))

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Search and simulate the experiments of a shard."""
        spec, indices = self.spec, self.spec.experiments_of_shard(shard)
        experiments: list[Experiment] = []
        with Simulator() as simulator:
            for first in indices[::2]:
                pair = first // 2
                experiments += spec.scenario.twin_pair(
                    spec.num_objects, data_seed=spec.data_seed, pair=pair, simulator=simulator
                )
                advance(2)
        path.write_bytes(encode(to_arrays(experiments, indices, spec), self.fields(shard), self.attributes(shard)))
        return {"simulations": simulator.num_simulations}

    def check_arrays(self, arrays: dict[str, np.ndarray], shard: int) -> None:
        for name, (first, end) in _ranges(self.spec).items():
            outside = arrays[name][(arrays[name] < first) | (arrays[name] >= end)]
            if len(outside):
                raise DamagedShardError(f"'{name}' holds {outside[0]}, expected {first} to {end - 1}")
        num_objects = self.spec.num_objects
        counted = [-1] * (self.spec.scenario.num_slots - num_objects) + list(range(num_objects))
        if (np.sort(arrays["object_index"], axis=1) != counted).any():
            raise DamagedShardError(f"'object_index' does not count {num_objects} objects")
        if ((arrays["shape"] > 0) != (arrays["object_index"] >= 0)).any():
            raise DamagedShardError("'shape' is given for other slots than 'object_index'")

    def write_manifest(self) -> None:
        """Vouch for a finished set, and say what it is."""
        super().write_manifest()
        write_card(self.spec, self.directory, f"not run yet, `{self.command_for('audit')}`")

    def description(self) -> dict[str, Any]:
        """Configuration and names of the cells."""
        spec = self.spec
        return {
            "id": spec.id,
            "configuration": spec.generating_configuration(),
            "cells": list(spec.scenario.cells()),
        }


def _ranges(spec: DatasetSpec) -> dict[str, tuple[int, int]]:
    """First and end of what an array that points at something may hold."""
    scenario = spec.scenario
    return {
        "shape": (0, max(Shape) + 1),
        "configuration": (0, scenario.confounders.num_configurations(spec.num_objects)),
        "do_operation": (0, len(scenario.do_operations)),
        "do_slot": (0, scenario.num_slots),
        "cell": (0, len(scenario.cells())),
        "twin": (0, spec.num_experiments // 2),
        "split": (0, len(SPLITS)),
    }


class StoredTowers(NamedTuple):
    """The towers of A (sequence 0) and C (1), and what they are made of.

    xy: (experiment, 2, level, 2) block centres at t = 0, metres; yaw: (experiment, 2, level), rad. num_levels:
    (experiment, 2), fewer in a C whose top block is removed: levels above mean nothing.
    mass: (experiment, level), kg; tilt: (experiment, 2), horizontal over vertical gravity.
    """

    xy: np.ndarray
    yaw: np.ndarray
    num_levels: np.ndarray
    mass: np.ndarray
    tilt: np.ndarray


def stored_towers(arrays: dict[str, np.ndarray], num_objects: int) -> StoredTowers:
    """The towers of a dataset's experiments, with `num_objects` blocks in A."""
    index = np.where(arrays["object_index"] < 0, num_objects, arrays["object_index"])
    levels = index.argsort(axis=1)[:, :num_objects]
    initial = np.take_along_axis(arrays["states"][:, :, 0], levels[:, None, :, None], axis=2)
    return StoredTowers(
        xy=initial[..., :2],
        yaw=2 * np.arctan2(initial[..., 5], initial[..., 6]),
        num_levels=arrays["presence"].sum(axis=2),
        mass=np.take_along_axis(arrays["mass"], levels, axis=1),
        tilt=arrays["gravity"][:, :2] / -arrays["gravity"][:, 2:],
    )
