"""Predictions from outside this framework: their files, and the truth of a test split that they are scored with.

A file has the ids of experiments, so their order does not matter. There are two kinds:

- .npz with the arrays of `cophy.scoring.Predictions`: experiment (n,) and position (n, T-1, K, 3) or samples
  (n, S, T-1, K, 3); optionally stable_logit. The predictions.npz of a run is one.
- .parquet with a line per experiment, object and frame: id, slot, frame (1 … T-1), x, y, z; optionally sample (0 … S-1) and
  stable_logit. It needs pyarrow.

Nothing here imports torch.
"""

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cophy.atomic_files import MAX_ARRAY_BYTES, read_npz, write_atomically
from cophy.config import generated_by
from cophy.dataset.experiment_set import ExperimentSet
from cophy.dataset.splits import Split
from cophy.dataset.states import reduce_to_frames
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scoring import Predictions, Truth

KEY = ["id", "slot", "frame"]  # columns that identify a line of a table, with `sample`
VALUES = ["x", "y", "z"]
REMEDY = "score.py template=FILE writes a file with all ids"


@dataclass(frozen=True)
class TestedSplit:
    """The test half of a split.

    Attributes:
        truth: The outcomes, twins next to each other.
        observed: (n, T-1, K, 3) positions in AB after its first frame, m.
        groups: Kind of group ("cell", "do_operation") -> name -> (n,) bool, which experiments belong to it.
        dataset_id: Of the dataset.
    """

    truth: Truth
    observed: np.ndarray
    groups: Mapping[str, Mapping[str, np.ndarray]]
    dataset_id: str


def load_truth(
    scenario: str,
    *,
    split: str | None = None,
    size: str = "small",
    data_seed: int = 0,
    data_dir: str | Path | None = None,
) -> Truth:
    """Return the truth of a test split, for `cophy.score`. The dataset must be there; nothing is generated.

    Args:
        scenario: blocktower, balls or collision.
        split: A name of conf/split; None for the default of the scenario.
        size: sample, tiny, small, 12k or paper.
        data_seed: Seed of the dataset.
        data_dir: Folder of the datasets; None for $COPHY_DATA, or data.

    Raises:
        CophyError: A name does not exist, or the data are missing or damaged; the message says what to do.
    """
    from cophy.cli import settings_from_python  # a command has imported it

    keys = {"scenario": scenario, "split": split, "size": size, "data_seed": data_seed}
    config = settings_from_python("generate", *(f"{key}={value}" for key, value in keys.items() if value is not None))
    if data_dir is not None:
        config.data_dir = os.path.expanduser(data_dir)
    (experiments,) = (each for each in generated_by(config) if each.spec.num_objects == config.split.test.num_objects)
    return read_test_split(experiments, config.scenario, config.split).truth


def read_test_split(experiments: ExperimentSet, scenario: Scenario, split: Split) -> TestedSplit:
    """Read the test half of a split.

    Raises:
        CophyError: The dataset is not finished or damaged.
    """
    if not experiments.is_finished():
        raise CophyError(f"{experiments.directory} is not finished: run `{experiments.command}` first")
    arrays = experiments.load()
    rows = np.flatnonzero(split.test.select_split(arrays, "test", scenario))
    if not len(rows):
        raise CophyError(f"split={split.name} has no test experiment in {experiments.directory}: {experiments.remedy}")
    rows = rows[np.argsort(experiments.pairs(rows), kind="stable")]
    tested = reduce_to_frames({name: array[rows] for name, array in arrays.items()}, scenario)
    position, task = tested["states"][..., :3], scenario.task
    truth = Truth(
        experiment=rows,
        position=position[:, 1, 1:].copy(),
        stable=tested["stable"][:, 1],
        presence=tested["presence"][:, 1],
        initial=position[:, 1, 0].copy(),
        pair=experiments.pairs(rows).astype(np.int64),
        cluster=experiments.clusters(rows),
        cell=tested["cell"].astype(np.int64),
        metric_dims=task.metric_dims,
        by_height=task.by_height,
        camera=scenario.camera,
    )
    names = {"cell": scenario.cells(), "do_operation": scenario.do_operations}
    groups = {
        kind: {name: tested[kind] == index for index, name in enumerate(of_kind) if (tested[kind] == index).any()}
        for kind, of_kind in names.items()
        if len(of_kind) > 1
    }
    return TestedSplit(truth, position[:, 0, 1:].copy(), groups, experiments.id)


def write_template(path: Path, test: TestedSplit) -> None:
    """Write a file of predictions in which nothing moves, to be filled. It is sorted by id, so that it does not tell which are twins.

    Raises:
        CophyError: The name of the file ends in neither .npz nor .parquet, or it exists.
    """
    if path.exists():
        raise CophyError(f"{path} exists: choose another name")
    truth, file = test.truth, io.BytesIO()
    order = np.argsort(truth.experiment)
    ids, presence = truth.experiment[order], truth.presence[order]
    position = np.repeat(truth.initial[order][:, None], truth.position.shape[1], axis=1)
    if _is_table(path):
        row, step, slot = np.nonzero(np.broadcast_to(presence[:, None], position.shape[:3]))
        columns = {"id": ids[row], "slot": slot, "frame": step + 1}
        columns |= dict(zip(VALUES, position[row, step, slot].T, strict=True))
        arrow = _arrow(path)
        arrow.parquet.write_table(arrow.table(columns), file)
    else:
        np.savez_compressed(file, experiment=ids, position=position)
    write_atomically(path, file.getvalue())


def read_predictions_file(path: Path, truth: Truth) -> Predictions:
    """Read predictions of the experiments of a test split; `cophy.score` checks their numbers.

    Raises:
        CophyError: The file is missing or damaged, or lines are missing, unknown or there twice.
    """
    try:
        return _from_table(path, truth) if _is_table(path) else _from_arrays(path)
    except ValueError as error:
        raise CophyError(f"{path}: {error}") from error


def _is_table(path: Path) -> bool:
    if path.suffix not in (".npz", ".parquet"):
        raise CophyError(f"{path}: its name has to end in .npz or .parquet")
    return path.suffix == ".parquet"


def _from_arrays(path: Path) -> Predictions:
    arrays = read_npz(path, ["experiment"], ["position", "samples", "stable_logit"])
    if "samples" in arrays:
        samples = arrays["samples"]
        if samples.dtype.kind != "f" or samples.ndim != 5 or not samples.size:
            raise ValueError(f"samples is {samples.dtype} of shape {samples.shape}, not floats of (n, S, T-1, K, 3)")
        arrays["position"] = samples.mean(axis=1)
    if "position" not in arrays:
        raise ValueError(f"it has neither position nor samples; {REMEDY}")
    return Predictions.from_arrays(arrays)


def _from_table(path: Path, truth: Truth) -> Predictions:
    columns = _read_columns(path)
    count, steps, slots, _ = truth.position.shape
    order = np.argsort(truth.experiment)
    row = order[np.searchsorted(truth.experiment, columns["id"], sorter=order).clip(max=count - 1)]
    step, slot = columns["frame"].astype(np.int64) - 1, columns["slot"].astype(np.int64)
    sample = columns.get("sample", np.zeros_like(slot)).astype(np.int64)

    def refuse(wrong: np.ndarray, problem: str) -> None:
        if wrong.any():
            first = wrong.argmax()
            where = ", ".join(f"{name} {columns[name][first]}" for name in KEY)
            raise ValueError(f"{wrong.sum()} lines {problem}, the first has {where}; {REMEDY}")

    refuse(truth.experiment[row] != columns["id"], "name an experiment that is not in this test split")
    refuse((step < 0) | (step >= steps), f"have a frame that is not from 1 to {steps}")
    refuse((slot < 0) | (slot >= slots), f"have a slot that is not from 0 to {slots - 1}")
    refuse(~truth.presence[row, slot], "name a slot that is empty in C")
    num_samples = int(sample.max(initial=0)) + 1
    per_sample = steps * int(truth.presence.sum())
    refuse((sample < 0) | (sample > len(sample) // per_sample), "have a sample number that is too large")
    place = np.ravel_multi_index((row, sample, step, slot), (count, num_samples, steps, slots))
    unique, first = np.unique(place, return_index=True)
    refuse(~np.isin(np.arange(len(place)), first), "are there twice")
    if len(place) < num_samples * per_sample:
        present = np.broadcast_to(truth.presence[:, None, None], (count, num_samples, steps, slots)).ravel()
        missing = np.setdiff1d(np.flatnonzero(present), unique)
        at, of_sample, at_step, in_slot = np.unravel_index(missing[0], (count, num_samples, steps, slots))
        names = f"id {truth.experiment[at]}, slot {in_slot}, frame {at_step + 1}, sample {of_sample}"
        raise ValueError(f"{len(missing)} lines are missing, the first is {names}; {REMEDY}")
    samples = np.zeros((count, num_samples, steps, slots, 3))
    samples[row, sample, step, slot] = np.stack([columns[name] for name in VALUES], axis=-1)
    logit = None
    if "stable_logit" in columns:
        logits = np.zeros((count, num_samples, steps, slots))
        logits[row, sample, step, slot] = columns["stable_logit"]
        logit = logits.mean(axis=1)
    several = samples if num_samples > 1 else None
    return Predictions(truth.experiment, samples.mean(axis=1), logit, samples=several)


def _read_columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a table of predictions."""
    arrow = _arrow(path)
    if not path.is_file():
        raise ValueError("there is no such file")
    try:
        file = arrow.parquet.ParquetFile(path)
        schema, types = file.schema_arrow, arrow.types
        names = [*KEY, *VALUES, *(name for name in ("sample", "stable_logit") if name in schema.names)]
        if missing := [name for name in names if name not in schema.names]:
            raise ValueError(f"columns {', '.join(missing)} are missing; {REMEDY}")
        if repeated := [name for name in names if schema.names.count(name) > 1]:
            raise ValueError(f"columns {', '.join(repeated)} are there twice")
        integers = [name for name in names if types.is_integer(schema.field(name).type)]
        floats = [name for name in names if types.is_floating(schema.field(name).type)]
        if wrong := [name for name in names if name not in (*integers, *floats)]:
            raise ValueError(f"{', '.join(wrong)}: these columns hold no numbers")
        if wrong := [name for name in (*KEY, "sample") if name in floats]:
            raise ValueError(f"{', '.join(wrong)}: these columns hold no integers")
        if file.metadata.num_rows * len(names) * 8 > MAX_ARRAY_BYTES:
            raise ValueError(f"more than {MAX_ARRAY_BYTES} bytes of numbers")
        table = file.read(columns=names)
    except (arrow.ArrowException, OSError) as error:
        raise ValueError(" ".join(str(error).split())) from error
    if incomplete := [name for name in names if table[name].null_count]:
        raise ValueError(f"{', '.join(incomplete)}: values are missing in these columns")
    return {name: table[name].to_numpy() for name in names}


def _arrow(path: Path) -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise CophyError(f"{path}: tables need a package, pip install pyarrow; or use an .npz file") from error
    return pyarrow
