"""What the report asks about the names of runs; the command line answers (`cophy.report_choices`).

What a run left, read with care: a file that is not what train.py writes is an error that says why.
Which runs of a row may be averaged: those that differ in their seed alone.
outputs/ as a table with one line per run, each checked to be what its name says.
"""

import json
import logging
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from yaml import YAMLError

from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.training.run import FAILURE, METRICS, differences, plain_value, read_predictions

log = logging.getLogger(__name__)

NAMES = ("scenario", "split", "model", "ablation", "positions", "seed", "size")
POSITIONS = {  # what a predictor sees, and how the report says it
    "ground_truth": "true positions",
    "derendered": "estimated positions",
    "train_ground_truth_test_derendered": "estimated positions in testing",
}
DATASETS = "dataset_ids"
CHECKPOINTS = ("derenderer", "predictor")  # that were given, each by a hash
COUNTS = ("num_train", "num_test", "training_seconds", "wall_seconds")
MAX_BYTES = 1 << 20  # ours: a run's files have some kilobytes
NEVER_NEGATIVE = ("mse", "final_position_error", "pixel_error", "pixel_error_by_height")


def notice(text: str) -> str:
    """A text as lines that the terminal does not break."""
    return textwrap.fill(text, Console().width, break_on_hyphens=False)


def read_line(path: Path) -> dict[str, Any]:
    """Names, counts, metrics and intervals of metrics.json, or names and error of failure.json.

    Raises:
        CophyError: It is not what train.py writes, or the predictions beside it are not.
    """
    content = _json(path)
    line: dict[str, Any] = {name: _text(content, name) for name in NAMES if name != "seed"}
    line["seed"] = int(_number(content, "seed"))
    line["variant"] = content.get("variant", "")
    if line["positions"] not in POSITIONS:
        raise CophyError(f"positions: {_short(line['positions'])} is not among {', '.join(POSITIONS)}")
    if path.name == FAILURE:
        return line | {"error": _text(content, "error"), "has_begun": content.get("has_begun") is not False}
    line |= {name: _number(content, name, at_least=0.0) for name in COUNTS} | {"error": None}
    line |= {name: content.get(name) for name in (DATASETS, *CHECKPOINTS)}
    if not _is_texts(line[DATASETS]) or not all(isinstance(line[name], str | None) for name in CHECKPOINTS):
        raise CophyError("dataset_ids, derenderer or predictor are no names")
    line["is_trained"] = line["training_seconds"] > 0 or line["predictor"] is not None  # here, or before
    metrics, intervals = content.get("metrics"), content.get("intervals")
    if not (isinstance(metrics, dict) and isinstance(intervals, dict)):
        raise CophyError("metrics or intervals are missing")
    for name in metrics:
        low_high = intervals.get(name)
        if not isinstance(low_high, list) or len(low_high) != 2:
            raise CophyError(f"there is no interval of {name}")
        bounds = {f"{name}_{end}": value for end, value in zip(("low", "high"), low_high, strict=True)}
        least = 0.0 if name in NEVER_NEGATIVE else None
        line[name] = _number(metrics, name, at_least=least)
        line |= {key: _number(bounds, key) for key in bounds}
    if not line["model"].startswith("derenderer"):
        read_predictions(path.parent)
    return line


def read_configuration(path: Path) -> DictConfig:
    """config.yaml, as Hydra writes it: without aliases, which can stand for more than fits in memory.

    Raises:
        CophyError: It is something else.
    """
    text = _read(path).decode()
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=yaml.SafeLoader)):
        raise CophyError(f"{path.name} holds aliases, Hydra writes none")
    found = OmegaConf.create(text)
    if not isinstance(found, DictConfig):
        raise CophyError(f"{path.name} is no configuration")
    return found


def _read(path: Path) -> bytes:
    if not path.is_file() or path.stat().st_size > MAX_BYTES:
        raise CophyError(f"{path.name} is no file, or larger than {MAX_BYTES} bytes")
    return path.read_bytes()


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(_read(path))
    except (ValueError, RecursionError) as error:
        raise CophyError(f"{path.name} is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise CophyError(f"{path.name} is no dictionary")
    return content


def _text(content: dict[str, Any], name: str) -> str:
    value = content.get(name)
    if not isinstance(value, str):
        raise CophyError(f"{name}: {_short(value)} is no text")
    return value


def _is_texts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(each, str) for each in value)


def _number(content: dict[str, Any], name: str, *, at_least: float | None = None) -> float:
    """A finite number; draws that are taken out may leave a mean of squares a little below zero."""
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 1e300 or not math.isfinite(value):
        raise CophyError(f"{name}: {_short(value)} is no finite number")
    if at_least is not None and value < at_least - 1e-3:
        raise CophyError(f"{name}: {_short(value)} is negative")
    return value


def _short(value: object) -> str:
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**20 else "a number of many digits"
    return text if len(text) <= 40 else f"{text[:40]}…"


def of_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """Of finished runs of one row and size, those of the longest training and of the de-renderer that most of them saw.

    Args:
        runs: See `read_runs`; `epochs` may be NaN where nothing was trained.
    """
    longest = runs if runs["epochs"].isna().all() else runs[runs["epochs"] == runs["epochs"].max()]
    if "derenderer" not in longest or longest["derenderer"].nunique() < 2:
        return longest
    return longest[longest["derenderer"] == longest["derenderer"].mode().iloc[0]]


def of_largest_size(runs: pd.DataFrame) -> pd.DataFrame:
    """Of finished runs, those of the size with most training experiments; others saw other data."""
    return runs[runs["size"] == runs.sort_values("num_train")["size"].iloc[-1]]


MOST_REFUSED = 3  # that are named
MISSING = "—"
CHOICE = ["scenario", "split", "model", "ablation", "positions", "size"]
IN_CAPTIONS = "trainer.max_epochs"  # may differ, as sizes may: each table says how long was trained


def read_runs(outputs: Path, keys_of: Callable[[dict[str, Any]], dict[str, Any]]) -> pd.DataFrame:
    """The runs in `outputs` that lie where train.py puts them, so that no two share their names.

    A run whose configuration or data are not those of its names fills no table (an override on the command line beats
    what a row says). The log names it.

    Args:
        outputs: Where train.py wrote its runs.
        keys_of: See `Choices.keys_of`.

    Returns:
        (`attrs`: how many are `unused`, and of these how many cannot be read, `skipped`.) One line each: names, directory, counts, epochs, metric_dims, every test metric and its interval (`_low`, `_high`). A failed
        run has its `error` instead of results; `error` is None for the others. One that was refused before it began is
        left out.
    """
    places = [f"*/*/*/*/*/seed*/{name}" for name in (METRICS, FAILURE)]
    lines, aside, refused, skipped = [], dict[str, list[str]](), list[Path](), 0
    for path in sorted(found for place in places for found in outputs.glob(place)):
        try:
            line = read_line(path)
            _check_place(line, path.parent)
            changes = _changes(line, path.parent, keys_of(line)) if line["error"] is None else []
        except (CophyError, OmegaConfBaseException) as error:
            skipped += 1
            log.warning("%s is skipped: %s", path, " ".join(str(error).split()))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OSError, YAMLError) as error:
            skipped += 1
            log.warning("%s is skipped: %s: %s", path, type(error).__name__, " ".join(str(error).split()))
        else:
            if line.pop("has_begun", True) is False:
                refused.append(path.parent)
            elif changes:
                aside.setdefault(", ".join(changes), []).append(" ".join(str(line[name]) for name in NAMES[:3]))
            else:
                lines.append(line | {"directory": path.parent})
    for reason, names in aside.items():
        one = "1 run fills no table, as its configuration or data are its own"
        said = (
            one if len(names) == 1 else f"{len(names)} runs fill no table, as their configuration or data are their own"
        )
        log.warning(notice(f"{said} ({reason}): {'; '.join(names)}."))
    if refused:
        some = ", ".join(map(str, refused[:MOST_REFUSED])) + (", …" if len(refused) > MOST_REFUSED else "")
        said = f"Runs that were refused before they began, and do not count: {len(refused)}. Remove their folders to forget them: {some}"
        log.info(notice(said))
    if elsewhere := len(set(outputs.rglob(METRICS)).difference(*(outputs.glob(place) for place in places))):
        said = f"Runs below {outputs} that do not lie where train.py puts them (hydra.run.dir=), and are not read: {elsewhere}."
        log.info(notice(said))
    table = pd.DataFrame(lines)
    table.attrs |= {"skipped": skipped, "unused": skipped + len(refused) + sum(map(len, aside.values()))}
    return table


def metrics_of(runs: pd.DataFrame) -> list[str]:
    """The names of all metrics that some run has."""
    return [column.removesuffix("_low") for column in runs.columns if column.endswith("_low")]


def summary(runs: pd.DataFrame) -> pd.DataFrame:
    """All runs: cost and test metrics, as means over seeds, ± standard deviation where there are several.

    Trainings of other lengths, or of other de-renderers, have lines of their own.
    """
    if runs.empty:
        return runs
    rows, apart = [], [name for name in ("epochs", "derenderer") if name in runs]
    for keys, found in runs.assign(**{name: runs[name].map(_name) for name in apart}).groupby([*CHOICE, *apart]):
        choice, others = keys[: len(CHOICE)], keys[len(CHOICE) :]
        line = {"run": " ".join(str(name) for name in choice), "seeds": _seeds(found)}
        line |= dict(zip(apart, map(str, others), strict=True))
        if "training_seconds" in found and found["training_seconds"].notna().any():
            trained_before = found["predictor"].notna()
            line["training (s)"] = (
                MISSING if trained_before.all() else f"{found.loc[~trained_before, 'training_seconds'].mean():.0f}"
            )
        line |= {metric.replace("_", " "): _show(found[metric].dropna()) for metric in metrics_of(found)}
        rows.append(line)
    return pd.DataFrame(rows).fillna(MISSING)


def _name(value: str | float | None) -> str:
    return value if isinstance(value, str) else MISSING if value is None or np.isnan(value) else f"{value:.0f}"


def _seeds(found: pd.DataFrame) -> str:
    failed = int(found["error"].notna().sum())
    return f"{len(found) - failed}" + (f" ({failed} failed)" if failed else "")


def _show(values: "pd.Series[float]") -> str:
    if values.empty:
        return MISSING
    return f"{values.mean():.3f}" if len(values) == 1 else f"{values.mean():.3f} ± {values.std():.3f}"


def _check_place(line: dict[str, Any], directory: Path) -> None:
    names = [str(line[name]) for name in NAMES[:5]] + [f"seed{line['seed']}{line['variant']}"]
    if list(directory.parts[-6:]) != names:
        raise CophyError(f"it says it is {'/'.join(names)}")


def _changes(line: dict[str, Any], directory: Path, expected: dict[str, Any]) -> list[str]:
    """Keys of the run's own configuration, and dataset_ids, that are not what its names stand for; notes its epochs and metric_dims in the line."""
    own = read_configuration(directory / ".hydra" / "config.yaml")
    line["epochs"], line["metric_dims"] = _epochs(line, own), int(own.scenario.task.metric_dims)
    has = {key: line[key] if key == DATASETS else plain_value(own, key) for key in expected}
    changed = (pair for key, value in expected.items() for pair in differences(key, has[key], value))
    return [f"{key}={value}" for key, value in changed if key != IN_CAPTIONS]


def _epochs(line: dict[str, Any], own: Any) -> int:
    """How long predictors of the run's split are trained; de-renderers see all of the data, whatever the split."""
    of_predictor = not line["model"].startswith("derenderer")
    factor = OmegaConf.select(own, "split.epochs_factor", default=1) if of_predictor else 1
    return max(int(own.trainer.max_epochs) * factor, -1)


class Choices(Protocol):
    """What the names under which a run was chosen stand for."""

    def keys_of(self, names: Mapping[str, Any]) -> dict[str, Any]:
        """The keys of the configuration that make a run of these names the run it claims to be, with their values.

        Of a predictor on generated data, `dataset_ids`, too: those that are generated today.

        Raises:
            CophyError: The names compose no configuration, or the run is on data of another source.
        """
        ...

    def scenario(self, name: str) -> Scenario:
        """The scenario of this name."""
        ...

    def split(self, scenario: str, name: str) -> Split:
        """A split of a scenario."""
        ...

    def dataset(
        self, scenario: str, num_objects: int, size: str, data_seed: int = 0, overrides: Sequence[str] = ()
    ) -> States:
        """The generated dataset that runs use, or another one of these names.

        Args:
            scenario: Name of their scenario.
            num_objects: In A of every experiment.
            size: Name of their size.
            data_seed: Of the dataset.
            overrides: What it changes beyond its names, see `DatasetSpec`.

        Raises:
            CophyError: This is no configuration of data.
        """
        ...
