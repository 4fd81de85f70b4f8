"""The runs below outputs/ as a table with one line per run, and which of them may be averaged."""

import functools
import json
import logging
import math
import textwrap
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from rich.console import Console

from cophy.errors import CophyError
from cophy.training.run import FAILURE, METRICS

log = logging.getLogger(__name__)

PLACE = ("scenario", "split", "model", "ablation", "positions")  # folders above that of a run, in this order
POSITIONS = {  # what a predictor sees, and how the report says it
    "ground_truth": "true positions",
    "derendered": "estimated positions",
    "train_ground_truth_test_derendered": "estimated positions in testing",
}
CHECKPOINTS = ("derenderer", "predictor")  # hashes of checkpoints that the user named
COUNTS = ("num_train", "num_test", "training_seconds", "wall_seconds")
# parts of a variant that leave a run in its table: captions name the size, the epochs and the de-renderer
IN_CAPTIONS = ("size-", "max_epochs-", "derenderer-")
MISSING = "—"

DatasetIds = Callable[[str, str], Collection[str] | None]  # (scenario, size) -> today's datasets, None if not checked


def notice(text: str) -> str:
    """Wrap a text at the width of the terminal."""
    return textwrap.fill(text, Console().width, break_on_hyphens=False)


def read_line(path: Path) -> dict[str, Any]:
    """Return names, counts, metrics and intervals of metrics.json, or names and error of failure.json.

    Raises:
        CophyError: The file is not what train.py writes.
    """
    try:
        content = json.loads(path.read_bytes())
    except ValueError as error:
        raise CophyError(f"{path.name} is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise CophyError(f"{path.name} is no dictionary")
    line: dict[str, Any] = {name: _text(content, name) for name in (*PLACE, "size")}
    line |= {"seed": int(_number(content, "seed")), "variant": content.get("variant", ""), "directory": path.parent}
    if path.name == FAILURE:
        return line | {"error": _text(content, "error"), "has_begun": content.get("has_begun") is not False}
    line |= {name: _number(content, name) for name in COUNTS} | {"error": None}
    line |= {name: content.get(name) for name in ("dataset_ids", *CHECKPOINTS)}
    line["is_trained"] = line["training_seconds"] > 0 or line["predictor"] is not None  # in this run or an earlier one
    metrics, intervals = content.get("metrics"), content.get("intervals")
    if not (isinstance(metrics, dict) and isinstance(intervals, dict) and isinstance(line["dataset_ids"], list)):
        raise CophyError("metrics, intervals or dataset_ids are missing: run the same command again")
    for name in metrics:
        line[name] = _number(metrics, name)
        match intervals.get(name):
            case [low, high]:
                bounds = {f"{name}_low": low, f"{name}_high": high}
                line |= {key: _number(bounds, key) for key in bounds}
            case other:
                raise CophyError(f"intervals.{name}: {other} is no interval")
    line["metric_dims"], line["epochs"] = _dims_and_epochs(content, path.parent)
    return line


def _text(content: dict[str, Any], name: str) -> str:
    value = content.get(name)
    if not isinstance(value, str):
        raise CophyError(f"{name}: {value} is no text")
    return value


def _number(content: dict[str, Any], name: str) -> float:
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CophyError(f"{name}: {value} is no finite number")
    return value


def _dims_and_epochs(content: dict[str, Any], directory: Path) -> tuple[int, int]:
    """Return the coordinates that count for the MSE and the epochs; earlier versions left them to .hydra/config.yaml."""
    if "metric_dims" in content and "max_epochs" in content:
        return int(_number(content, "metric_dims")), int(_number(content, "max_epochs"))
    path = directory / ".hydra" / "config.yaml"
    try:
        config = yaml.load(path.read_bytes(), Loader=yaml.CSafeLoader)
        factor = 1 if content["model"].startswith("derenderer") else config["split"].get("epochs_factor", 1)
        epochs = max(factor * int(config["trainer"]["max_epochs"]), -1)  # -1 is no limit
        return int(config["scenario"]["task"]["metric_dims"]), epochs
    except (OSError, yaml.YAMLError, KeyError, ValueError) as error:
        raise CophyError(f"no metric_dims in {METRICS}, and none in {path.name}: run the same command again") from error


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
        One line per run: names, directory, counts, epochs, metric_dims, every test metric and its interval (`_low`,
        `_high`). A failed run has its `error` instead of results; `error` is None for the others. `attrs`: how many runs
        are `unused`, because they fill no table or cannot be read.
    """
    paths = sorted(path for name in (METRICS, FAILURE) for path in outputs.glob(f"*/*/*/*/*/seed*/{name}"))
    dataset_ids = functools.cache(dataset_ids)
    lines, excluded, unused = [], dict[str, list[str]](), 0
    for path in paths:
        try:
            line = read_line(path)
            _check_place(line)
            reason = _reason_to_exclude(line, dataset_ids)
        except CophyError as error:
            unused += 1
            log.warning("%s is skipped: %s", path, " ".join(str(error).split()))
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


def _check_place(line: dict[str, Any]) -> None:
    names = [*(line[name] for name in PLACE), f"seed{line['seed']}{line['variant']}"]
    if list(line["directory"].parts[-len(names) :]) != names:
        raise CophyError(f"its content is of {'/'.join(names)}")
    if line["positions"] not in POSITIONS:
        raise CophyError(f"positions: {line['positions']} is not among {', '.join(POSITIONS)}")


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
