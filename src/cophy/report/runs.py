"""The runs below outputs/ as a table with one line per run, and which of them may be averaged."""

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

NAMES = ("scenario", "split", "model", "ablation", "positions", "seed", "size")
POSITIONS = {  # what a predictor sees, and how the report says it
    "ground_truth": "true positions",
    "derendered": "estimated positions",
    "train_ground_truth_test_derendered": "estimated positions in testing",
}
CHECKPOINTS = ("derenderer", "predictor")  # hashes of checkpoints that the user named
COUNTS = ("num_train", "num_test", "training_seconds", "wall_seconds")
# parts of a variant that leave a run in its table: captions name the size, the epochs and the de-renderer
IN_CAPTIONS = ("size-", "max_epochs-", "derenderer-")
MAX_LISTED = 3  # directories in one message
MISSING = "—"
ROW = ["scenario", "split", "model", "ablation", "positions", "size"]

DatasetIds = Callable[[str, str], Collection[str] | None]  # (scenario, size) -> today's datasets, None if not checked


def notice(text: str) -> str:
    """Wrap a text at the width of the terminal."""
    return textwrap.fill(text, Console().width, break_on_hyphens=False)


def read_line(path: Path) -> dict[str, Any]:
    """Return names, counts, metrics and intervals of metrics.json, or names and error of failure.json.

    Raises:
        CophyError: The file is not what train.py writes.
    """
    content = _read_json(path)
    line: dict[str, Any] = {name: _text(content, name) for name in NAMES if name != "seed"}
    line |= {"seed": int(_number(content, "seed")), "variant": content.get("variant", ""), "directory": path.parent}
    if path.name == FAILURE:
        return line | {"error": _text(content, "error"), "has_begun": content.get("has_begun") is not False}
    line |= {name: _number(content, name) for name in COUNTS} | {"error": None}
    line |= {name: content.get(name) for name in ("dataset_ids", *CHECKPOINTS)}
    line["is_trained"] = line["training_seconds"] > 0 or line["predictor"] is not None  # here, or before
    metrics, intervals = content.get("metrics"), content.get("intervals")
    if not (isinstance(metrics, dict) and isinstance(intervals, dict) and isinstance(line["dataset_ids"], list)):
        raise CophyError("metrics, intervals or dataset_ids are missing: run the same command again")
    for name in metrics:
        match intervals.get(name):
            case [low, high]:
                bounds = {f"{name}_low": low, f"{name}_high": high}
            case other:
                raise CophyError(f"intervals.{name}: {other} is no interval")
        line[name] = _number(metrics, name)
        line |= {key: _number(bounds, key) for key in bounds}
    line["metric_dims"], line["epochs"] = _dims_and_epochs(content, path.parent)
    return line


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except ValueError as error:
        raise CophyError(f"{path.name} is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise CophyError(f"{path.name} is no dictionary")
    return content


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

    A run that changes more than its names say (an override on the command line), or whose data are not those that its
    names stand for today, fills no table. The log names it, and each file that cannot be read.

    Args:
        outputs: Where train.py wrote its runs.
        dataset_ids: Returns the ids that the datasets of a scenario and size have today; None where they are not checked.
            Raises CophyError where the runs are not for these tables.

    Returns:
        One line per run: names, directory, counts, epochs, metric_dims, every test metric and its interval (`_low`,
        `_high`). A failed run has its `error` instead of results; `error` is None for the others. A run that was refused
        before it began is left out. `attrs`: how many are `unused`, and how many of these cannot be read (`skipped`).
    """
    patterns = [f"*/*/*/*/*/seed*/{name}" for name in (METRICS, FAILURE)]
    paths = sorted(path for pattern in patterns for path in outputs.glob(pattern))
    lines, excluded, refused, skipped = [], dict[str, list[str]](), list[Path](), 0
    for path in paths:
        try:
            line = read_line(path)
            _check_place(line)
            changes = _changes(line, dataset_ids)
        except CophyError as error:
            skipped += 1
            log.warning("%s is skipped: %s", path, " ".join(str(error).split()))
            continue
        if not line.pop("has_begun", True):
            refused.append(path.parent)
        elif changes:
            excluded.setdefault(changes, []).append(" ".join(str(line[name]) for name in NAMES[:3]))
        else:
            lines.append(line)
    for reason, names in excluded.items():
        message = f"{_count(names)} not in the tables, which show the settings of conf/ ({reason}): {'; '.join(names)}."
        log.warning(notice(message))
    if refused:
        some = ", ".join(map(str, refused[:MAX_LISTED])) + (", …" if len(refused) > MAX_LISTED else "")
        log.info(notice(f"{_count(refused)} refused before the start. Remove the folders to forget them: {some}"))
    if elsewhere := len(set(outputs.rglob(METRICS)).difference(paths)):
        log.info(
            notice(
                f"{elsewhere} runs below {outputs} are not where train.py puts them and are not read (hydra.run.dir=)."
            )
        )
    table = pd.DataFrame(lines)
    table.attrs |= {"skipped": skipped, "unused": skipped + len(refused) + sum(map(len, excluded.values()))}
    return table


def _count(runs: Collection[object]) -> str:
    return "1 run is" if len(runs) == 1 else f"{len(runs)} runs are"


def _check_place(line: dict[str, Any]) -> None:
    names = [str(line[name]) for name in NAMES[:5]] + [f"seed{line['seed']}{line['variant']}"]
    if list(line["directory"].parts[-6:]) != names:
        raise CophyError(f"its content is of {'/'.join(names)}")
    if line["positions"] not in POSITIONS:
        raise CophyError(f"positions: {line['positions']} is not among {', '.join(POSITIONS)}")


def _changes(line: dict[str, Any], dataset_ids: DatasetIds) -> str:
    """Return what a finished run changes beyond its names; "" where it may fill a table."""
    if line["error"] is not None:
        return ""
    parts = line["variant"].removeprefix("+").split("+")
    changes = [part for part in parts if part and not part.startswith(IN_CAPTIONS)]
    known = dataset_ids(line["scenario"], line["size"])
    if known is not None and not line["model"].startswith("derenderer"):
        changes += [f"dataset {name}" for name in line["dataset_ids"] if name not in known]
    return ", ".join(changes)


def comparable_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """Return those finished runs of one row and size that differ in their seed alone.

    They are the runs of the longest training and, of these, those that used the most frequent de-renderer.

    Args:
        runs: See `read_runs`; `epochs` may be NaN where nothing was trained.
    """
    longest = runs if runs["epochs"].isna().all() else runs[runs["epochs"] == runs["epochs"].max()]
    if "derenderer" not in longest or longest["derenderer"].nunique() < 2:
        return longest
    return longest[longest["derenderer"] == longest["derenderer"].mode().iloc[0]]


def largest_size(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the finished runs of the size with most training experiments; the others saw other data."""
    return runs[runs["size"] == runs.sort_values("num_train")["size"].iloc[-1]]


def summarize_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Return cost and test metrics of all runs: means over seeds, ± standard deviation where there are several.

    Trainings of other lengths, or with other de-renderers, have lines of their own.
    """
    if runs.empty:
        return runs
    lines, separate = [], [name for name in ("epochs", "derenderer") if name in runs]
    metrics = [column.removesuffix("_low") for column in runs.columns if column.endswith("_low")]
    named = runs.assign(**{name: runs[name].map(_as_name) for name in separate})
    for keys, seeds in named.groupby([*ROW, *separate]):
        failed = int(seeds["error"].notna().sum())
        line = {"run": " ".join(map(str, keys[: len(ROW)]))}
        line["seeds"] = f"{len(seeds) - failed}" + (f" ({failed} failed)" if failed else "")
        line |= dict(zip(separate, map(str, keys[len(ROW) :]), strict=True))
        if "training_seconds" in seeds and seeds["training_seconds"].notna().any():
            seconds = seeds.loc[seeds["predictor"].isna(), "training_seconds"]
            line["training (s)"] = MISSING if seconds.empty else f"{seconds.mean():.0f}"
        line |= {metric.replace("_", " "): _mean_and_deviation(seeds[metric].dropna()) for metric in metrics}
        lines.append(line)
    return pd.DataFrame(lines).fillna(MISSING)


def _as_name(value: str | float | None) -> str:
    return value if isinstance(value, str) else MISSING if value is None or np.isnan(value) else f"{value:.0f}"


def _mean_and_deviation(values: "pd.Series[float]") -> str:
    if values.empty:
        return MISSING
    return f"{values.mean():.3f}" if len(values) == 1 else f"{values.mean():.3f} ± {values.std():.3f}"
