"""outputs/ as a table with one line per run, each checked to be what its name says."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from cophy.errors import CophyError
from cophy.report.runs.stored_run import DATASETS, NAMES, read_configuration, read_line
from cophy.report.tables.terminal_tables import notice
from cophy.training.runs.identity import FAILURE, METRICS, differences, plain_value

log = logging.getLogger(__name__)

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
