"""The index of a dataset that lies elsewhere: its states, confounders and presence, gathered in one pass into shards."""

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cophy.dataset.external.files import BrokenFileError
from cophy.dataset.external.layout import Layout
from cophy.dataset.external.lists import UNLISTED, read_lists
from cophy.dataset.external.recording import BrokenExperimentError, to_row
from cophy.dataset.external.spec import ExternalSpec, listing
from cophy.dataset.shardset import DamagedShardError, ShardSet, dataset_in
from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.states import encode
from cophy.errors import CophyError
from cophy.files import write_atomically
from cophy.scenario import Scenario

log = logging.getLogger(__name__)

LONGEST_PROBLEM = 300  # bytes
EMPTY = "an empty folder"
BROKEN = "broken.txt"


class ExternalStates(ShardSet):
    """What `dataset.states.States` is for generated data, over experiments that someone else wrote.

    Its arrays lack what only our search knows (strata, twins' configurations); `twin` is the experiment itself.
    """

    spec: ExternalSpec

    def __init__(
        self,
        layout: Layout,
        root: Path,
        scenario: Scenario,
        num_objects: int,
        *,
        split: Split,
        lists: Path | None,
        data_dir: Path,
    ) -> None:
        self.split = split
        folders = [root / "splits", root] if lists is None else [lists]
        self.lists = read_lists(folders, [layout.list_names(scenario, num_objects, split, part) for part in SPLITS])
        directory = layout.directory(root, scenario, num_objects)
        spec = ExternalSpec(scenario, num_objects, layout, directory, listing(directory))
        super().__init__(
            spec,
            data_dir / scenario.name / spec.id,
            title=f"index of {scenario.name}, {num_objects} objects",
            command=(
                f"python src/audit.py source={layout.name} source.root={root} scenario={scenario.name} split={split.name} "
                f"'num_objects=[{num_objects}]' data_dir={data_dir}"
            ),
        )

    @property
    def id(self) -> str:
        """Name of the data: the index, and a hash of the lists that split it."""
        return f"{self.spec.id}-{self.lists.digest}"

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Read the experiments of a shard; a broken one leaves zeros, and what is wrong with it."""
        indices = self.spec.experiments_of_shard(shard)
        arrays = {name: np.zeros(shape, dtype) for name, (shape, dtype) in self._layout(shard).items()}
        for row, index in enumerate(indices):
            try:
                for name, value in self._read(self.spec.directory / self.spec.ids[index]).items():
                    arrays[name][row] = value
            except (BrokenFileError, BrokenExperimentError) as error:
                arrays["problem"][row] = str(error).encode()[:LONGEST_PROBLEM]
            advance(1)
        path.write_bytes(encode(arrays))
        return {}

    def check(self, path: Path, shard: int) -> None:
        """Read it all."""
        self._decode(path, shard)

    def description(self) -> dict[str, Any]:
        """Where the data lie, and as what they were read."""
        return {"id": self.spec.id, **self.spec.reading()}

    def load(self) -> dict[str, np.ndarray]:
        """The arrays of all whole experiments that the lists name, by id; what is broken is reported."""
        checksums, shards = self.finished_checksums(), []
        for shard in range(self.spec.num_shards):
            with self.explained(shard):
                self.verify(shard, checksums[self.path(shard).name])
                shards.append(self._decode(self.path(shard), shard))
        arrays = {name: np.concatenate([part[name] for part in shards]) for name in shards[0]}
        problems = [problem.decode(errors="replace") for problem in arrays.pop("problem").tolist()]
        self._report(problems)
        arrays["experiment"] = np.arange(self.spec.num_experiments)
        whole = np.array([not problem for problem in problems])
        arrays = {name: array[whole] for name, array in arrays.items()}
        arrays["twin"] = np.arange(len(arrays["experiment"]))
        return self._listed(self._with_trusted_gravity(arrays))

    def with_clip(self, shard: int) -> np.ndarray:
        """(experiment, 2) whether AB and CD have an RGB clip."""
        with self.explained(shard):
            self.verify(shard, self.finished_checksums()[self.path(shard).name])
            return self._decode(self.path(shard), shard)["clip"]

    def _read(self, directory: Path) -> dict[str, Any]:
        if any((directory / part).is_symlink() for part in ("ab", "cd")):
            raise BrokenFileError(f"{directory} holds links in the place of ab or cd")
        if not os.listdir(directory):
            raise BrokenExperimentError(EMPTY)
        return to_row(self.spec.layout.read(directory, self.spec.scenario), self.spec.scenario, self.spec.num_objects)

    def _report(self, problems: list[str]) -> None:
        """Say how many are broken, and list them beside the index."""
        named = zip(self.spec.ids, problems, strict=True)
        broken = [(name, problem) for name, problem in named if problem not in ("", EMPTY)]
        empty = problems.count(EMPTY)
        if empty:
            log.info("%s: %d empty folders are passed over", self.spec.directory, empty)
        if not broken:
            return
        text = "".join(f"{name}: {problem}\n" for name, problem in broken)
        write_atomically(self.directory / BROKEN, text.encode())
        found = f"{len(broken)} of {len(problems) - empty} experiments are broken, the first is {broken[0][0]}: {broken[0][1]}"
        if len(broken) + empty == len(problems):
            raise CophyError(f"{self.spec.directory}: {found}")
        log.warning("%s: %s; all are listed in %s", self.spec.directory, found, self.directory / BROKEN)

    def _with_trusted_gravity(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Where some gravity.txt does not hold gravity, none is believed."""
        doubtful = np.isnan(arrays["gravity"]).any(axis=1)
        if doubtful.any():
            log.warning(
                "%s: %d of %d experiments come without a gravity on the grid (the released generator writes two frictions "
                "into gravity.txt): gravity counts as unknown in all of them",
                *(self.spec.directory, doubtful.sum(), len(doubtful)),
            )
            arrays["gravity"][:, :2] = np.nan
        return arrays

    def _listed(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The listed experiments, with `split` and `seen`; a list that contradicts the data is refused."""
        ids = [self.spec.ids[index] for index in arrays["experiment"]]
        place = self.lists.split_of(ids)
        if missing := self.lists.missing(ids):
            log.warning("%s: %d listed experiments are broken or not there", self.spec.directory, missing)
        rows = place != UNLISTED
        arrays = {name: array[rows] for name, array in arrays.items()} | {"split": place[rows]}
        arrays["seen"] = arrays["split"] != SPLITS.index("test")
        if self.split.train.moving is None or not self.spec.layout.lists_by_shape:
            return arrays
        for number, (name, path) in enumerate(zip(SPLITS, self.lists.paths, strict=True)):
            part = self.split.test if name == "test" else self.split.train
            wrong = ((arrays["split"] == number) & ~part.select(arrays)).sum()
            if wrong:
                raise CophyError(f"{path}: in {wrong} of the listed experiments the moving object is no {part.moving}")
        return arrays

    def _decode(self, path: Path, shard: int) -> dict[str, np.ndarray]:
        try:
            with h5py.File(path, "r") as file:
                return {
                    name: np.asarray(dataset_in(file, name, *what)[()]) for name, what in self._layout(shard).items()
                }
        except (OSError, KeyError, RuntimeError) as error:
            raise DamagedShardError(" ".join(str(error).split())) from error

    def _layout(self, shard: int) -> dict[str, tuple[tuple[int, ...], str]]:
        slots, times = self.spec.scenario.num_slots, self.spec.scenario.clock.num_frames
        shapes: dict[str, tuple[tuple[int, ...], str]] = {
            "states": ((2, times, slots, 13), "<f4"),
            "presence": ((2, slots), "|b1"),
            "shape": ((slots,), "|u1"),
            "object_index": ((slots,), "|i1"),
            "mass": ((slots,), "<f4"),
            "friction": ((slots,), "<f4"),
            "restitution": ((slots,), "<f4"),
            "gravity": ((3,), "<f4"),
            "do_slot": ((), "|u1"),
            "do_offset": ((3,), "<f4"),
            "clip": ((2,), "|b1"),
            "problem": ((), f"|S{LONGEST_PROBLEM}"),
        }
        count = len(self.spec.experiments_of_shard(shard))
        return {name: ((count, *shape), dtype) for name, (shape, dtype) in shapes.items()}
