"""The runs below outputs/ as a table with one line per run, and which of them a table may show or average."""

import logging
import os
import re
import textwrap
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from cophy.atomic_files import read_json
from cophy.errors import CophyError, check_name, printable
from cophy.report.paper_tables import methods
from cophy.training.run import FAILURE, LARGEST_NUMBER, METRICS, short_keys

log = logging.getLogger(__name__)

PLACE = ("scenario", "split", "model", "ablation", "positions")  # folders above that of a run, in this order
POSITIONS = {  # what a predictor sees, and how the report says it
    "ground_truth": "true positions",
    "derendered": "estimated positions",
    "train_ground_truth_test_derendered": "estimated positions in testing",
}
COST = ("training_cpu_seconds", "parameters", "learning_rate")
CHECKPOINTS = ("derenderer", "predictor")  # hashes of the checkpoints that a run used
VARIANT = re.compile(r"(\+[\w.+-]+)?")
KEY = re.compile(r"[\w./@-]+")
DATA_KEYS = ("data_seed", "confounders", "source_scenario", "scenario.", "size.", "split.")  # how keys of data begin
# how keys begin that matter to a training alone, and those of them that also matter to a model that is not trained
OF_TRAINING = ("trainer", "training.", "optimizer", "schedule", "loss")
OF_TESTS = ("training.num_experiments", "trainer.precision", "trainer.limit_test_batches")
ERROR = re.compile(r"\w+:")  # the start of a failed run's error; so it is no formula of a spreadsheet either
MAX_NAME, MAX_ERROR = 255, 2000  # characters
# parts of a variant that leave a run in a paper's table: captions name the size, the epochs and the de-renderer
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
        line: dict[str, Any] = {**_names(content, path.parent)}
        line |= {"seed": _count(content, "seed"), "directory": path.parent}
        if f"seed{line['seed']}{line['variant']}" != path.parent.name:
            raise ValueError("seed and variant are not those of its folder")
        line["changes"] = _changes(content, str(line["variant"]))
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


def _changes(content: dict[str, Any], variant: str) -> dict[str, str]:
    """Return what a run changes beyond its names; earlier versions wrote the last words of the keys, as its variant."""
    parts = (part.partition("-") for part in variant.removeprefix("+").split("+") if part)
    changes = content.get("changes", {key: value for key, _, value in parts})
    if not isinstance(changes, dict) or not all(
        isinstance(value, str) and len(value) <= MAX_ERROR and KEY.fullmatch(key) for key, value in changes.items()
    ):
        raise ValueError("changes are no keys with values")
    return {key: printable(value) for key, value in changes.items() if key != "size"}


def _failure(content: dict[str, Any]) -> dict[str, Any]:
    error = content.get("error")
    if not isinstance(error, str) or not ERROR.match(error):
        raise ValueError("error is no type and message of an error")
    return {"error": printable(" ".join(error[:MAX_ERROR].split())), "has_begun": content.get("has_begun") is not False}


def _results(content: dict[str, Any]) -> dict[str, Any]:
    metrics, intervals, ids = (content.get(name) for name in ("metrics", "intervals", "dataset_ids"))
    inputs = content.get("inputs", [])  # earlier versions did not write it
    if not (isinstance(metrics, dict) and isinstance(intervals, dict) and isinstance(ids, list) and "mse" in metrics):
        raise ValueError("it has no metrics.mse, no intervals or no dataset_ids")
    results: dict[str, Any] = {
        "error": None,
        "num_train": _count(content, "num_train"),
        "num_test": _count(content, "num_test", smallest=1),
        "epochs": _count(content, "max_epochs", smallest=-1),  # -1 is no limit
        "metric_dims": _count(content, "metric_dims", smallest=1, largest=3),
        **{name: _number(content, name) for name in ("training_seconds", "wall_seconds")},
        **{name: _number({name: 0, **content}, name) for name in COST},  # earlier versions did not write it
        "validation_mse": _validation_mse(content),
        "dataset_ids": [_name({"dataset_ids": each}, "dataset_ids") for each in ids],
        "inputs": [_name({"inputs": each}, "inputs") for each in inputs] if isinstance(inputs, list) else [],
        **{name: None if content.get(name) is None else _name(content, name) for name in (*CHECKPOINTS, "optimizer")},
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


def _validation_mse(content: dict[str, Any]) -> float:
    """Return the validation MSE of the tested weights; NaN where nothing was validated."""
    validation = content.get("validation")
    if not isinstance(validation, dict) or "val/mse" not in validation:
        return np.nan
    return _number(validation, "val/mse")


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


def read_runs(outputs: Path) -> pd.DataFrame:
    """Return the runs in `outputs` that are where train.py puts them, so that no two share their names.

    The log names each file that cannot be read. A run that was refused before it began is none.

    Returns:
        One line per run (one of those that train nothing and differ in keys of training alone): names, directory, counts, epochs,
        metric_dims, validation_mse, inputs (optional ones that the model sees), every test metric and its interval (see
        `read_line`). `data` is what the run changes in its data, as text, and `changes` what else it changes (key, value). A failed run has its `error` instead of results; `error` is None for the
        others. `attrs`: how many runs are `unused`, because they cannot be read; `root`, the folder that has those in `outputs`
        at their place, if none is read.
    """
    paths = sorted(path for name in (METRICS, FAILURE) for path in outputs.glob(f"*/*/*/*/*/seed*/{name}"))
    lines, unused = [], 0
    for path in paths:
        try:
            line = read_line(path)
        except (CophyError, OSError) as error:
            unused += 1
            log.warning("%s", " ".join(f"{path.parent} is skipped: {error}".split()))
            continue
        if line.pop("has_begun", True):
            lines.append(line)
    whole = {
        word: key for key, word in short_keys({key for line in lines for key in line["changes"] if "." in key}).items()
    }
    for line in lines:
        changes = {whole.get(key, key): value for key, value in line["changes"].items()}
        if line.get("is_trained") is False:
            changes, line["variant"] = _without_training(changes, line["variant"])
        line["data"] = ", ".join(f"{key}={changes[key]}" for key in changes if key.startswith(DATA_KEYS))
        line["changes"] = tuple((key, value) for key, value in changes.items() if not key.startswith(DATA_KEYS))
    others = set(outputs.rglob(METRICS)).difference(paths)
    root = None if paths or not others else _root(min(others))
    if others and root is None:
        text = f"{len(others)} runs below {outputs} are not where train.py puts them and are not read (hydra.run.dir=)."
        log.info(notice(text))
    table = pd.DataFrame(_different(lines))
    table.attrs |= {"unused": unused, "root": root}
    return table


def _without_training(changes: dict[str, str], variant: str) -> tuple[dict[str, str], str]:
    """Return changes and variant of a run that trained nothing without the keys that matter to a training alone."""
    parts = [part for part in variant.split("+")[1:] if not part.startswith("size-")]
    if len(parts) != len(changes):  # it was too long and ends in a hash
        return changes, variant
    unused = {key for key in changes if key.startswith(OF_TRAINING) and key not in OF_TESTS}
    left_out = [part for key, part in zip(changes, parts, strict=True) if key in unused]
    kept = [part for part in variant.split("+")[1:] if part not in left_out]
    return {key: changes[key] for key in changes if key not in unused}, "".join(f"+{part}" for part in kept)


def _different(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the lines without those of untrained runs that are the same run as another line, with more changed keys."""
    kept: dict[Any, dict[str, Any]] = {}
    for line in lines:
        is_same_as = line["directory"]
        if line.get("is_trained") is False:
            is_same_as = (*(line[name] for name in (*PLACE, "seed", "variant")), *line["dataset_ids"])
        other = kept.setdefault(is_same_as, line)
        if len(line["directory"].name) < len(other["directory"].name):
            kept[is_same_as] = line
    return [*kept.values()]


def _root(path: Path) -> Path | None:
    """Return the folder below which a file of results is where train.py puts it; None if there is none."""
    whole = path.resolve()
    try:
        read_line(whole)
        root = whole.parents[len(PLACE) + 1]
    except (CophyError, OSError, IndexError):
        return None
    return root if path.is_absolute() else Path(os.path.relpath(root))


def elsewhere(runs: pd.DataFrame) -> str:
    """Return what to do where `read_runs` has found only runs of another folder; "" if there are none."""
    root = runs.attrs.get("root")
    return f"its runs are where train.py puts them below {root}: outputs={root}" if root is not None else ""


def filter_runs(runs: pd.DataFrame, models: Sequence[str], splits: Sequence[str]) -> pd.DataFrame:
    """Return the runs of these models and splits; an empty list is no condition.

    Args:
        runs: See `read_runs`.
        models: Names of models or rows: cophynet has all its ablations, cophynet_mlp is one.
        splits: Names of splits.

    Raises:
        CophyError: No run has one of these names.
    """
    rows = {(method.model, method.ablation): method.name for method in methods().values()}
    of_rows = [
        {model, f"{model}_{ablation}", rows.get((model, ablation), model)}
        for model, ablation in zip(runs["model"], runs["ablation"], strict=True)
    ]
    is_chosen = np.ones(len(runs), dtype=bool)
    for key, names, of_runs in (("models", models, of_rows), ("splits", splits, [{name} for name in runs["split"]])):
        known = set().union(*of_runs) - {f"{model}_full" for model in runs["model"]}
        if missing := sorted(set(names) - known):
            raise CophyError(f"{key}=: there is no run of {', '.join(missing)}; there are {', '.join(sorted(known))}")
        if names:
            is_chosen &= [not of_run.isdisjoint(names) for of_run in of_runs]
    chosen = runs[is_chosen]
    if chosen.empty:
        raise CophyError(f"there is no run of models={[*models]} and splits={[*splits]}")
    return chosen


def standard_runs(runs: pd.DataFrame, dataset_ids: DatasetIds) -> pd.DataFrame:
    """Return the runs that a paper's table may show: on today's data, with no change but what captions name.

    Args:
        runs: See `read_runs`.
        dataset_ids: Returns the ids that the datasets of a scenario and size have today; None where they are not checked.
            Raises CophyError where the runs are not for these tables.
    """
    is_standard = pd.Series(False, index=runs.index)
    for (scenario, size), group in runs.groupby(["scenario", "size"]):
        try:
            known = dataset_ids(str(scenario), str(size))
        except CophyError:
            continue
        is_standard[group.index] = [_is_standard(line, known) for line in group.to_dict("records")]
    return runs[is_standard]


def _is_standard(line: dict[Any, Any], known: Collection[str] | None) -> bool:
    parts = line["variant"].removeprefix("+").split("+")
    is_checked = known is not None and line["error"] is None and not line["model"].startswith("derenderer")
    return all(not part or part.startswith(IN_CAPTIONS) for part in parts) and (
        not is_checked or set(line["dataset_ids"]) <= set(known or ())
    )


def select(runs: pd.DataFrame, **names: str) -> pd.DataFrame:
    """Return the lines that have these values in the columns of these names."""
    if runs.empty:
        return runs
    return runs[np.logical_and.reduce([runs[name] == value for name, value in names.items()])]


def comparable_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """Return those finished runs of one row and size that differ in their seed alone.

    They are the runs of the longest training and, of these, those that used the most frequent de-renderer; of several runs with
    one seed (a de-renderer may be named in several ways), the one that changes the fewest keys.

    Args:
        runs: See `read_runs`; `epochs` may be NaN where nothing was trained.
    """
    if len(runs) == 1:
        return runs
    runs = runs.sort_values("variant", key=lambda variants: variants.str.len(), kind="stable")
    is_trained = runs["epochs"].notna().any() and ("is_trained" not in runs or runs["is_trained"].any())
    longest = runs[runs["epochs"] == runs["epochs"].max()] if is_trained else runs
    if "derenderer" in longest and longest["derenderer"].nunique() > 1:
        longest = longest[longest["derenderer"] == longest["derenderer"].mode().iloc[0]]
    return longest.drop_duplicates("seed").sort_index()


def largest_size(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the finished runs of the size with most training experiments; the others saw other data."""
    return runs[runs["size"] == runs.sort_values("num_train")["size"].iloc[-1]]
