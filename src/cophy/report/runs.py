"""The runs below outputs/ as a table with one line per run, and which of them may be averaged."""

import functools
import logging
import re
import textwrap
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from cophy.atomic_files import read_json
from cophy.errors import CophyError, check_name, printable
from cophy.training.run import FAILURE, LARGEST_NUMBER, METRICS

log = logging.getLogger(__name__)

PLACE = ("scenario", "split", "model", "ablation", "positions")  # folders above that of a run, in this order
POSITIONS = {  # what a predictor sees, and how the report says it
    "ground_truth": "true positions",
    "derendered": "estimated positions",
    "train_ground_truth_test_derendered": "estimated positions in testing",
}
CHECKPOINTS = ("derenderer", "predictor")  # hashes of checkpoints that the user named
VARIANT = re.compile(r"(\+[\w.+-]+)?")
ERROR = re.compile(r"\w+:")  # the start of a failed run's error; so it is no formula of a spreadsheet either
MAX_NAME, MAX_ERROR = 255, 2000  # characters
# parts of a variant that leave a run in its table: captions name the size, the epochs and the de-renderer
IN_CAPTIONS = ("size-", "max_epochs-", "derenderer-")
MISSING = "—"

DatasetIds = Callable[[str, str], Collection[str] | None]  # (scenario, size) -> today's datasets, None if not checked


def notice(text: str) -> str:
    """Wrap a text at the width of the terminal."""
    return textwrap.fill(text, Console().width, break_on_hyphens=False)


def read_line(path: Path) -> dict[str, Any]:
    """Return names, counts, metrics and intervals of metrics.json, or names and error of failure.json.

    Metrics have keys of their own, so that none is taken for anything else: `metrics.<name>`, and `low.<name>` and
    `high.<name>` for the interval.

    Args:
        path: The file, in the directory where train.py puts it.

    Raises:
        CophyError: The file is not what train.py writes.
        OSError: It cannot be read.
    """
    try:
        content = read_json(path)
        line = _names(content, path.parent) | {"seed": _count(content, "seed"), "directory": path.parent}
        if f"seed{line['seed']}{line['variant']}" != path.parent.name:
            raise ValueError("seed and variant are not those of its folder")
        return line | (_failure(content) if path.name == FAILURE else _results(content))
    except ValueError as error:
        raise CophyError(f"{path.name} was not written by train.py: {error}") from error


def _names(content: dict[str, Any], directory: Path) -> dict[str, str]:
    """Return the names of a run, which are those of the folders that it is in."""
    names = dict(zip(PLACE, directory.parts[-len(PLACE) - 1 : -1], strict=True)) | {
        "variant": content.get("variant", "")
    }
    if others := [name for name in PLACE if content.get(name) != names[name]]:
        raise ValueError(f"{', '.join(others)} are not those of its folder")
    for name in ("size", *PLACE):
        names[name] = _name(content, name)
    if names["positions"] not in POSITIONS:
        raise ValueError(f"positions are not among {', '.join(POSITIONS)}")
    if not isinstance(names["variant"], str) or not VARIANT.fullmatch(names["variant"]):
        raise ValueError("variant is invalid")
    return names


def _failure(content: dict[str, Any]) -> dict[str, Any]:
    error = content.get("error")
    if not isinstance(error, str) or not ERROR.match(error):
        raise ValueError("error is no type and message of an error")
    return {"error": printable(" ".join(error[:MAX_ERROR].split())), "has_begun": content.get("has_begun") is not False}


def _results(content: dict[str, Any]) -> dict[str, Any]:
    metrics, intervals, ids = (content.get(name) for name in ("metrics", "intervals", "dataset_ids"))
    if not (isinstance(metrics, dict) and isinstance(intervals, dict) and isinstance(ids, list) and "mse" in metrics):
        raise ValueError("it has no metrics.mse, no intervals or no dataset_ids")
    results: dict[str, Any] = {
        "error": None,
        "num_train": _count(content, "num_train"),
        "num_test": _count(content, "num_test", smallest=1),
        "epochs": _count(content, "max_epochs", smallest=-1),  # -1 is no limit
        "metric_dims": _count(content, "metric_dims", smallest=1, largest=3),
        **{name: _number(content, name) for name in ("training_seconds", "wall_seconds")},
        "dataset_ids": [_name({"dataset_ids": each}, "dataset_ids") for each in ids],
        **{name: None if content.get(name) is None else _name(content, name) for name in CHECKPOINTS},
    }
    results["is_trained"] = results["training_seconds"] > 0 or results["predictor"] is not None  # here or earlier
    for name in metrics:
        _name({"a name of metrics": name}, "a name of metrics")
        results[f"metrics.{name}"] = _number(metrics, name)
        match intervals.get(name):
            case [low, high]:
                ends = {f"low.{name}": low, f"high.{name}": high}
                results |= {end: _number(ends, end) for end in ends}
            case _:
                raise ValueError(f"intervals.{name} is no interval")
    return results


def _name(content: dict[str, Any], key: str) -> str:
    """Return a name that every medium shows as it is."""
    name = content.get(key)
    if not isinstance(name, str) or len(name) > MAX_NAME:
        raise ValueError(f"{key} is no name")
    check_name(key, name)
    return name


def _number(content: dict[str, Any], name: str) -> float:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST_NUMBER:
        raise ValueError(f"{name} is no number up to {LARGEST_NUMBER:g}")
    return float(value)


def _count(content: dict[str, Any], name: str, *, smallest: int = 0, largest: float = LARGEST_NUMBER) -> int:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not smallest <= value <= largest:
        raise ValueError(f"{name} is no integer from {smallest} to {largest:g}")
    return value


def read_runs(outputs: Path, dataset_ids: DatasetIds) -> pd.DataFrame:
    """Return the runs in `outputs` that are where train.py puts them, so that no two share their names.

    A run that changes more than its names say (an override on the command line), whose data are not those that its names
    stand for today, or that was refused before it began, fills no table. The log names it, and each file that cannot be
    read.

    Args:
        outputs: Where train.py wrote its runs.
        dataset_ids: Returns the ids that the datasets of a scenario and size have today; None where they are not checked.
            Raises CophyError where the runs are not for these tables.

    Returns:
        One line per run: names, directory, counts, epochs, metric_dims, every test metric and its interval (see `read_line`).
        A failed run has its `error` instead of results; `error` is None for the others. `attrs`: how many runs are `unused`,
        because they fill no table or cannot be read.
    """
    paths = sorted(path for name in (METRICS, FAILURE) for path in outputs.glob(f"*/*/*/*/*/seed*/{name}"))
    dataset_ids = functools.cache(dataset_ids)
    lines, excluded, unused = [], dict[str, list[str]](), 0
    for path in paths:
        try:
            line = read_line(path)
            reason = _reason_to_exclude(line, dataset_ids)
        except (CophyError, OSError) as error:
            unused += 1
            log.warning("%s", " ".join(f"{path.parent} is skipped: {error}".split()))
            continue
        if reason:
            excluded.setdefault(reason, []).append(" ".join(line[name] for name in PLACE[:3]))
        else:
            lines.append(line)
    for reason, names in excluded.items():
        runs = "1 run is" if len(names) == 1 else f"{len(names)} runs are"
        log.warning(
            notice(f"{runs} not in the tables, which show the settings of conf/ ({reason}): {'; '.join(names)}.")
        )
    if elsewhere := len(set(outputs.rglob(METRICS)).difference(paths)):
        text = f"{elsewhere} runs below {outputs} are not where train.py puts them and are not read (hydra.run.dir=)."
        log.info(notice(text))
    table = pd.DataFrame(lines)
    table.attrs["unused"] = unused + sum(map(len, excluded.values()))
    return table


def _reason_to_exclude(line: dict[str, Any], dataset_ids: DatasetIds) -> str:
    """Return what a run changes beyond its names, or that it was refused; "" where it may fill a table."""
    if line["error"] is not None:
        return "" if line.pop("has_begun") else "refused before the start"
    parts = line["variant"].removeprefix("+").split("+")
    changes = [part for part in parts if part and not part.startswith(IN_CAPTIONS)]
    known = dataset_ids(line["scenario"], line["size"])
    if known is not None and not line["model"].startswith("derenderer"):
        changes += [f"dataset {name}" for name in line["dataset_ids"] if name not in known]
    return ", ".join(changes)


def select(runs: pd.DataFrame, **names: str) -> pd.DataFrame:
    """Return the lines that have these values in the columns of these names."""
    if runs.empty:
        return runs
    return runs[np.logical_and.reduce([runs[name] == value for name, value in names.items()])]


def comparable_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """Return those finished runs of one row and size that differ in their seed alone.

    They are the runs of the longest training and, of these, those that used the most frequent de-renderer.

    Args:
        runs: See `read_runs`; `epochs` may be NaN where nothing was trained.
    """
    if len(runs) == 1:
        return runs
    longest = runs if runs["epochs"].isna().all() else runs[runs["epochs"] == runs["epochs"].max()]
    if "derenderer" not in longest or longest["derenderer"].nunique() < 2:
        return longest
    return longest[longest["derenderer"] == longest["derenderer"].mode().iloc[0]]


def largest_size(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the finished runs of the size with most training experiments; the others saw other data."""
    return runs[runs["size"] == runs.sort_values("num_train")["size"].iloc[-1]]
