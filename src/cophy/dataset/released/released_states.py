"""The index of a dataset that lies elsewhere: its states, confounders and presence, gathered in one pass into shards."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from cophy.dataset.pictures.needed_frames import ALL, NeededFrames
from cophy.dataset.released import trust
from cophy.dataset.released.clips import Clips
from cophy.dataset.released.id_lists import read_lists
from cophy.dataset.released.protocol import ReleasedFormat
from cophy.dataset.released.recording import BrokenExperimentError, to_row
from cophy.dataset.released.released_spec import ReleasedSpec, listing
from cophy.dataset.released.untrusted_files import BrokenFileError
from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.state_features import Arrays
from cophy.dataset.store.experiment_arrays import scene_fields
from cophy.dataset.store.experiment_set import ExperimentSet, OracleSettings
from cophy.dataset.store.hdf5_arrays import Field, Fields, empty_arrays, encode
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering.frames import RenderSettings

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
            command=(
                f"python src/audit.py source={released_format.name} source.root={root} scenario={scenario.name} "
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
        trust.report_problems(problems, self.spec, self.directory)
        whole = np.array([not problem for problem in problems])
        arrays["experiment"] = np.arange(self.spec.num_experiments)
        arrays = {name: array[whole] for name, array in arrays.items()}
        arrays["twin"] = np.arange(len(arrays["experiment"]))
        arrays = trust.listed(trust.without_doubtful_gravity(arrays, self.spec), self.spec, self.lists)
        if self.split.train.moving is not None and self.spec.released_format.lists_by_shape:
            trust.check_moving_shapes(arrays, self.split, self.lists)
        return arrays

    def _experiment(self, directory: Path) -> dict[str, Any]:
        if any((directory / part).is_symlink() for part in ("ab", "cd")):
            raise BrokenFileError(f"{directory} holds links in the place of ab or cd")
        if not os.listdir(directory):
            raise BrokenExperimentError(trust.EMPTY)
        recording = self.spec.released_format.read(directory, self.spec.scenario)
        return to_row(recording, self.spec.scenario, self.spec.num_objects)
