"""The index of a released dataset: states, confounders and presence, read once into shards; clips are decoded when needed."""

import hashlib
import logging
import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from cophy.atomic_files import write_atomically
from cophy.dataset import generation
from cophy.dataset.experiment_set import (
    ALL_FRAMES,
    ExperimentSet,
    FrameReader,
    NeededFrames,
    ReadImages,
    SequenceFrames,
)
from cophy.dataset.shards import Arrays, Field, Fields, empty_arrays, encode
from cophy.dataset.source import Source
from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.states import scene_fields
from cophy.errors import CophyError
from cophy.released.formats import FORMATS, SEQUENCE_FOLDERS
from cophy.released.recording import to_row
from cophy.released.spec import ReleasedSpec, list_experiments, read_lists
from cophy.scenario import Scenario
from cophy.scenario.rendering import RenderSettings
from cophy.untrusted_files import BrokenFileError, open_clip

log = logging.getLogger(__name__)

EMPTY_FOLDER = "an empty folder"
BROKEN_LIST = "broken.txt"  # next to the index
MAX_PROBLEM_BYTES = 300


class ReleasedStates(ExperimentSet):
    """Experiments that someone else released.

    The arrays lack what only our search knows (cells, configurations). `twin` is the experiment itself, `experiment` its
    index in the spec, `clip` whether AB and CD have clips.
    """

    spec: ReleasedSpec

    def __init__(
        self, source: "ReleasedSource", scenario: Scenario, split: Split, num_objects: int, data_dir: Path
    ) -> None:
        if source.root is None:
            raise CophyError(f"source={source.name} needs source.root=, the folder that holds ballsCF, blocktowerCF, …")
        self.split, root, released_format = split, Path(source.root), FORMATS[source.name]
        folders = [root / "splits", root] if source.splits is None else [Path(source.splits)]
        names = [released_format.list_names(scenario, num_objects, split, part) for part in SPLITS]
        self.list_paths, self.list_ids = read_lists(folders, names)
        directory = released_format.directory(root, scenario, num_objects)
        spec = ReleasedSpec(scenario, num_objects, released_format, directory, list_experiments(directory))
        title = f"index of {scenario.name}, {num_objects} objects"
        places = " ".join(map(shlex.quote, (f"source.root={root}", f"data_dir={data_dir}")))
        keys = (
            f"source={source.name} scenario={scenario.name} split={split.name} 'num_objects=[{num_objects}]' {places}"
        )
        super().__init__(spec, data_dir / scenario.name / spec.id, title=title, script="audit", keys=keys)

    @property
    def id(self) -> str:
        """Name of the data: the index, and a hash of the lists that split it."""
        return f"{self.spec.id}-{hashlib.sha256(repr(self.list_ids).encode()).hexdigest()[:8]}"

    @property
    def remedy(self) -> str:
        lists = ", ".join(map(str, self.list_paths))
        return f"its lists of ids are {lists}; what could not be read is named in {self.directory}"

    def frames(self, render: RenderSettings, needed: NeededFrames = ALL_FRAMES) -> "ReleasedClips":
        return ReleasedClips(self)

    def pairs(self, rows: np.ndarray) -> np.ndarray:
        return rows  # they have no twins

    def clusters(self, rows: np.ndarray) -> np.ndarray:
        return rows

    def has_same_splits(self, *, data_seed: int, trained_on: Sequence[str]) -> bool:
        return self.id in trained_on

    def write(self, path: Path, shard: int, advance: Callable[[int], None]) -> dict[str, float]:
        """Read the experiments of a shard; a broken one is stored as zeros and a description of the problem."""
        fields = self.fields(shard)
        arrays = empty_arrays(fields)
        for row, index in enumerate(self.spec.experiments_of_shard(shard)):
            try:
                for name, value in self._read_experiment(self.spec.directory / self.spec.ids[index]).items():
                    arrays[name][row] = value
            except BrokenFileError as error:
                arrays["problem"][row] = str(error).encode()[:MAX_PROBLEM_BYTES]
            advance(1)
        path.write_bytes(encode(arrays, fields, self.attributes(shard)))
        return {}

    def _read_experiment(self, directory: Path) -> dict[str, Any]:
        if any((directory / part).is_symlink() for part in SEQUENCE_FOLDERS):
            raise BrokenFileError(f"{directory} holds links in the place of ab or cd")
        if not os.listdir(directory):
            raise BrokenFileError(EMPTY_FOLDER)
        recording = self.spec.released_format.read(directory, self.spec.scenario)
        return to_row(recording, self.spec.scenario, self.spec.num_objects)

    def fields(self, shard: int) -> Fields:
        scenario, count = self.spec.scenario, len(self.spec.experiments_of_shard(shard))
        return {
            **scene_fields(count, scenario.clock.num_frames, scenario.num_slots, may_be_nan=True),
            "do_slot": Field((count,), "|u1", limits=(0, scenario.num_slots - 1)),
            "do_offset": Field((count, 3), "<f4"),
            "clip": Field((count, 2), "|b1"),
            "problem": Field((count,), f"|S{MAX_PROBLEM_BYTES}"),
        }

    def description(self) -> dict[str, Any]:
        """Return where the data are, and how they were read."""
        return {"id": self.spec.id, **self.spec.reading()}

    def load(self, reduced: Callable[[Arrays], Arrays] = lambda arrays: arrays) -> Arrays:
        """Return the arrays of all complete experiments in the lists, by id, and report broken ones."""
        arrays = super().load(reduced)
        problems = [problem.decode(errors="replace") for problem in arrays.pop("problem").tolist()]
        self._report_problems(problems)
        complete = np.array([not problem for problem in problems])
        arrays["experiment"] = np.arange(self.spec.num_experiments)
        arrays = {name: array[complete] for name, array in arrays.items()}
        arrays["twin"] = np.arange(len(arrays["experiment"]))
        is_doubtful = np.isnan(arrays["gravity"]).any(axis=1)
        if is_doubtful.any():
            log.warning(
                "%s: %d of %d experiments come without a gravity on the grid (the released generator writes two frictions "
                "into gravity.txt): gravity counts as unknown in all of them",
                *(self.spec.directory, is_doubtful.sum(), is_doubtful.size),
            )
            arrays["gravity"][:, :2] = np.nan
        arrays = self._select_listed(arrays)
        if self.split.train.moving is not None and self.spec.released_format.lists_by_shape:
            self._check_moving_shapes(arrays)
        return arrays

    def _report_problems(self, problems: list[str]) -> None:
        """Log how many experiments are broken, and list them next to the index.

        Args:
            problems: the problem of each experiment, "" where there is none.

        Raises:
            CophyError: no experiment is complete.
        """
        named = zip(self.spec.ids, problems, strict=True)
        broken = [f"{name}: {problem}" for name, problem in named if problem not in ("", EMPTY_FOLDER)]
        if empty := problems.count(EMPTY_FOLDER):
            log.info("%s: %d empty folders are skipped", self.spec.directory, empty)
        if not broken:
            return
        write_atomically(self.directory / BROKEN_LIST, "".join(f"{line}\n" for line in broken).encode())
        message = f"{len(broken)} of {len(problems) - empty} experiments are broken, the first is {broken[0]}"
        if len(broken) + empty == len(problems):
            raise CophyError(f"{self.spec.directory}: {message}")
        log.warning("%s: %s; all are listed in %s", self.spec.directory, message, self.directory / BROKEN_LIST)

    def _select_listed(self, arrays: Arrays) -> Arrays:
        """Return the listed experiments, with `split` and `seen`."""
        splits = {name: split for split, names in enumerate(self.list_ids) for name in names}
        ids = [self.spec.ids[index] for index in arrays["experiment"]]
        if missing := len(set(splits) - set(ids)):
            log.warning("%s: %d listed experiments are broken or missing", self.spec.directory, missing)
        rows = [row for row, name in enumerate(ids) if name in splits]
        split = np.array([splits[ids[row]] for row in rows], dtype=np.uint8)
        arrays = {name: array[rows] for name, array in arrays.items()}
        return arrays | {"split": split, "seen": split != SPLITS.index("test")}

    def _check_moving_shapes(self, arrays: Arrays) -> None:
        """Check lists of the splits by the moving object's shape against the data.

        Raises:
            CophyError: a list names experiments in which another shape moves.
        """
        for number, path in enumerate(self.list_paths):
            part = self.split.test if SPLITS[number] == "test" else self.split.train
            fits = part.conditions(arrays, self.spec.scenario).get("moving", np.True_)
            if wrong := ((arrays["split"] == number) & ~fits).sum():
                raise CophyError(f"{path}: in {wrong} of the listed experiments the moving object is no {part.moving}")


class ReleasedClips:
    """RGB frames of released experiments. All clips are used, because the id lists decide what is tested."""

    name = "rgb.mp4"
    needed = ALL_FRAMES

    def __init__(self, states: ReleasedStates) -> None:
        self.states, self.spec = states, states.spec

    def ensure(self, *, workers: int) -> None:
        """Index the experiments; their clips cannot be generated."""
        generation.ensure(self.states, workers=workers)

    def checksums(self) -> None:
        """Return none: released clips have no checksums."""

    def sequences(self, shard: int) -> Iterator[SequenceFrames]:
        """Yield every frame of every clip."""
        experiments, times = self.spec.experiments_of_shard(shard), range(self.spec.scenario.clock.num_frames)
        for row, sequence in np.argwhere(self.states.read(shard)["clip"]).tolist():
            yield row, sequence, np.array(times), np.stack(list(self._decode(experiments[row], sequence, times)))

    def reader(self, arrays: Arrays) -> FrameReader:
        """Return a function that reads the frame of a row of the arrays, a sequence and a time."""
        return partial(self._read_frame, arrays["experiment"])

    def pictures(self, arrays: Arrays, modalities: Sequence[str]) -> ReadImages:
        """Return a function that decodes both clips of a row of the arrays; RGB is the only modality."""
        if unknown := set(modalities) - {"rgb"}:
            raise CophyError(f"released data have no {', '.join(sorted(unknown))}, only rgb")
        times = range(self.spec.scenario.clock.num_frames)

        def read(row: int) -> dict[str, np.ndarray]:
            experiment = int(arrays["experiment"][row])
            directory = self.spec.directory / self.spec.ids[experiment]
            if not arrays["clip"][row].all():
                raise CophyError(f"{directory} lacks a clip")
            ab, cd = (np.stack(list(self._decode(experiment, sequence, times))) for sequence in (0, 1))
            if ab.shape != cd.shape:
                raise CophyError(f"{directory}: the clips of ab and cd differ in size: download it again")
            return {"rgb": np.stack([ab, cd])}

        return read

    def _read_frame(self, experiment: np.ndarray, row: int, sequence: int, time: int) -> np.ndarray:
        (frame,) = self._decode(int(experiment[row]), sequence, range(time, time + 1))
        return frame

    def _decode(self, experiment: int, sequence: int, times: range) -> Iterator[np.ndarray]:
        """Yield frames, (R, R, 3) uint8. Earlier frames are skipped one by one: a seek is not exact in every MP4."""
        path = self.spec.directory / self.spec.ids[experiment] / SEQUENCE_FOLDERS[sequence] / self.name
        indices = [time * self.spec.released_format.frame_step for time in times]
        try:
            capture = open_clip(path)
        except BrokenFileError as error:
            raise CophyError(str(error)) from error
        edge = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        try:
            for index in range(indices[-1] + 1):
                if index not in indices:
                    capture.grab()
                    continue
                success, frame = capture.read()
                if not success or frame.shape != (edge, edge, 3):
                    raise CophyError(
                        f"{path}: frame {index} is missing, not square or of another size: download it again"
                    )
                yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
        finally:
            capture.release()


@dataclass
class ReleasedSource(Source):
    """Source of a dataset that others released (conf/source/).

    name: a key of `FORMATS`. root: folder of the dataset. splits: folder of its lists of ids; None if they are in `root`.
    """

    root: str | None = None
    splits: str | None = None

    def __post_init__(self) -> None:
        self.root, self.splits = (path and os.path.expanduser(path) for path in (self.root, self.splits))

    def experiment_sets(
        self, scenario: Scenario, split: Split, num_objects: list[int] | None, data_dir: Path
    ) -> list[ReleasedStates]:
        """Return one dataset per number of objects: those of the split, or `num_objects`; indices are in `data_dir`.

        Raises:
            CophyError: The data are missing.
        """
        return [ReleasedStates(self, scenario, split, count, data_dir) for count in split.counts(num_objects)]
