"""The index of a dataset that lies elsewhere: its states, confounders and presence, gathered in one pass into shards.

Which indexed experiments count, and what of them is believed.
"""

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from cophy.atomic_files import write_atomically
from cophy.dataset.experiment_set import ALL, ExperimentSet, NeededFrames, OracleSettings
from cophy.dataset.features import Arrays
from cophy.dataset.fields import scene_fields
from cophy.dataset.shards import Field, Fields, empty_arrays, encode
from cophy.dataset.splits import SPLITS, Split
from cophy.errors import CophyError
from cophy.released.clips import Clips, ReleasedSpec, listing
from cophy.released.protocol import UNLISTED, Lists, ReleasedFormat, read_lists
from cophy.released.recording import BrokenExperimentError, to_row
from cophy.scenario import Scenario
from cophy.scenario.rendering import RenderSettings
from cophy.untrusted_files import BrokenFileError

log = logging.getLogger(__name__)

EMPTY = "an empty folder"
BROKEN = "broken.txt"


def report_problems(problems: list[str], spec: ReleasedSpec, directory: Path) -> None:
    """Say how many experiments are broken, and list them beside the index.

    Args:
        problems: what is wrong with each experiment, "" where nothing is.
        spec: of the experiments.
        directory: of the index.

    Raises:
        CophyError: none is whole.
    """
    named = zip(spec.ids, problems, strict=True)
    broken = [(name, problem) for name, problem in named if problem not in ("", EMPTY)]
    empty = problems.count(EMPTY)
    if empty:
        log.info("%s: %d empty folders are passed over", spec.directory, empty)
    if not broken:
        return
    text = "".join(f"{name}: {problem}\n" for name, problem in broken)
    write_atomically(directory / BROKEN, text.encode())
    first = f"{broken[0][0]}: {broken[0][1]}"
    found = f"{len(broken)} of {len(problems) - empty} experiments are broken, the first is {first}"
    if len(broken) + empty == len(problems):
        raise CophyError(f"{spec.directory}: {found}")
    log.warning("%s: %s; all are listed in %s", spec.directory, found, directory / BROKEN)


def without_doubtful_gravity(arrays: Arrays, spec: ReleasedSpec) -> Arrays:
    """The arrays; where some gravity.txt does not hold gravity, none is believed."""
    doubtful = np.isnan(arrays["gravity"]).any(axis=1)
    if doubtful.any():
        log.warning(
            "%s: %d of %d experiments come without a gravity on the grid (the released generator writes two frictions "
            "into gravity.txt): gravity counts as unknown in all of them",
            *(spec.directory, doubtful.sum(), doubtful.size),
        )
        arrays["gravity"][:, :2] = np.nan
    return arrays


def listed(arrays: Arrays, spec: ReleasedSpec, lists: Lists) -> Arrays:
    """The listed experiments, with `split` and `seen`.

    Args:
        arrays: of all whole experiments; `experiment` says which of the spec they are.
        spec: of the experiments.
        lists: of ids.
    """
    ids = [spec.ids[index] for index in arrays["experiment"]]
    place = lists.split_of(ids)
    if missing := lists.missing(ids):
        log.warning("%s: %d listed experiments are broken or not there", spec.directory, missing)
    rows = place != UNLISTED
    arrays = {name: array[rows] for name, array in arrays.items()} | {"split": place[rows]}
    return arrays | {"seen": arrays["split"] != SPLITS.index("test")}


def check_moving_shapes(arrays: Arrays, split: Split, lists: Lists) -> None:
    """Refuse lists of the splits by the moving object's shape that contradict the data.

    Args:
        arrays: of the listed experiments.
        split: whose parts say what moves.
        lists: of ids.

    Raises:
        CophyError: a list names experiments in which another shape moves.
    """
    for number, (name, path) in enumerate(zip(SPLITS, lists.paths, strict=True)):
        part = split.test if name == "test" else split.train
        wrong = ((arrays["split"] == number) & ~part.select(arrays)).sum()
        if wrong:
            raise CophyError(f"{path}: in {wrong} of the listed experiments the moving object is no {part.moving}")


MAX_PROBLEM_BYTES = 300


class ReleasedStates(ExperimentSet):
    """Experiments that someone else released.

    Its arrays lack what only our search knows (cells, configurations). `twin` is the experiment itself, `experiment` its
    index in the spec, `clip` says whether AB and CD have pictures.
    """

    spec: ReleasedSpec

    def __init__(
        self,
        released_format: ReleasedFormat,
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
        names = [released_format.list_names(scenario, num_objects, split, part) for part in SPLITS]
        self.lists = read_lists(folders, names)
        directory = released_format.directory(root, scenario, num_objects)
        spec = ReleasedSpec(scenario, num_objects, released_format, directory, listing(directory))
        super().__init__(
            spec,
            data_dir / scenario.name / spec.id,
            title=f"index of {scenario.name}, {num_objects} objects",
            script="audit",
            keys=(
                f"source={released_format.name} source.root={root} scenario={scenario.name} "
                f"split={split.name} 'num_objects=[{num_objects}]' data_dir={data_dir}"
            ),
        )

    @property
    def id(self) -> str:
        """Name of the data: the index, and a hash of the lists that split it."""
        return f"{self.spec.id}-{self.lists.digest}"

    @property
    def remedy(self) -> str:
        lists = ", ".join(map(str, self.lists.paths))
        return f"its lists of ids are {lists}; what could not be read is named in {self.directory}"

    def frames(self, render: RenderSettings, needed: NeededFrames = ALL) -> Clips:
        return Clips(self, self.spec)

    def forecasts(self, settings: OracleSettings) -> NoReturn:
        raise CophyError("oracles simulate generated data: released data lack what a simulation starts from")

    def unseen_by(
        self, *, num_experiments: dict[str, dict[str, int]], data_seed: int, trained_on: Sequence[str]
    ) -> bool:
        return self.id in trained_on

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Read the experiments of a shard; a broken one leaves zeros, and what is wrong with it."""
        fields = self.fields(shard)
        arrays = empty_arrays(fields)
        for row, index in enumerate(self.spec.experiments_of_shard(shard)):
            try:
                for name, value in self._experiment(self.spec.directory / self.spec.ids[index]).items():
                    arrays[name][row] = value
            except (BrokenFileError, BrokenExperimentError) as error:
                arrays["problem"][row] = str(error).encode()[:MAX_PROBLEM_BYTES]
            advance(1)
        path.write_bytes(encode(arrays, fields, self.attributes(shard)))
        return {}

    def fields(self, shard: int) -> Fields:
        scenario, count = self.spec.scenario, len(self.spec.experiments_of_shard(shard))
        return {
            **scene_fields(count, scenario.clock.num_frames, scenario.num_slots),
            "do_slot": Field((count,), "|u1"),
            "do_offset": Field((count, 3), "<f4"),
            "clip": Field((count, 2), "|b1"),
            "problem": Field((count,), f"|S{MAX_PROBLEM_BYTES}"),
        }

    def description(self) -> dict[str, Any]:
        """Where the data lie, and as what they were read."""
        return {"id": self.spec.id, **self.spec.reading()}

    def load(self, reduced: Callable[[Arrays], Arrays] = lambda arrays: arrays) -> Arrays:
        """The arrays of all whole experiments that the lists name, by id; what is broken is reported."""
        arrays = super().load(reduced)
        problems = [problem.decode(errors="replace") for problem in arrays.pop("problem").tolist()]
        report_problems(problems, self.spec, self.directory)
        whole = np.array([not problem for problem in problems])
        arrays["experiment"] = np.arange(self.spec.num_experiments)
        arrays = {name: array[whole] for name, array in arrays.items()}
        arrays["twin"] = np.arange(len(arrays["experiment"]))
        arrays = listed(without_doubtful_gravity(arrays, self.spec), self.spec, self.lists)
        if self.split.train.moving is not None and self.spec.released_format.lists_by_shape:
            check_moving_shapes(arrays, self.split, self.lists)
        return arrays

    def _experiment(self, directory: Path) -> dict[str, Any]:
        if any((directory / part).is_symlink() for part in ("ab", "cd")):
            raise BrokenFileError(f"{directory} holds links in the place of ab or cd")
        if not os.listdir(directory):
            raise BrokenExperimentError(EMPTY)
        recording = self.spec.released_format.read(directory, self.spec.scenario)
        return to_row(recording, self.spec.scenario, self.spec.num_objects)
