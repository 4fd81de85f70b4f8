"""Which indexed experiments count, and what of them is believed."""

import logging
from pathlib import Path

import numpy as np

from cophy.atomic_files import write_atomically
from cophy.dataset.released.id_lists import UNLISTED, Lists
from cophy.dataset.released.released_spec import ReleasedSpec
from cophy.dataset.splits import SPLITS, Split
from cophy.errors import CophyError

log = logging.getLogger(__name__)

EMPTY = "an empty folder"
BROKEN = "broken.txt"

Arrays = dict[str, np.ndarray]


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
