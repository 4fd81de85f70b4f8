"""outputs/ -> one line per run, each checked to be what its name says."""

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

log = logging.getLogger(__name__)

NAMES = ("scenario", "split", "model", "ablation", "positions", "seed", "size")
COUNTS = ("num_train", "num_test", "training_seconds", "wall_seconds")


def read_runs(outputs: Path, configuration_of: Callable[[dict[str, Any]], dict[str, Any]]) -> pd.DataFrame:
    """Runs, one line each: names, directory, counts, epochs, every test metric and its interval (`_low`, `_high`).

    A failed run has its `error` instead, which is None for the others. configuration_of: from a run's names to the
    dotted keys that they stand for. A run whose own configuration differs (an override on the command line beats a
    row's setting) fills no table; the log names it.
    """
    lines = []
    for path in sorted([*outputs.rglob("metrics.json"), *outputs.rglob("failure.json")]):
        try:
            line = _failure(path) if path.name == "failure.json" else _read(path)
            if line["error"] is None:
                own: Any = OmegaConf.load(path.parent / ".hydra" / "config.yaml")
                line["epochs"] = int(own.trainer.max_epochs)
                changes = [
                    change
                    for key, expected in configuration_of(line).items()
                    for change in _differences(key, _plain(own, key), expected)
                ]
            else:
                changes = []
        except (ValueError, KeyError, TypeError, OSError, OmegaConfBaseException, HydraException, YAMLError) as error:
            log.warning("%s is skipped: %s: %s", path, type(error).__name__, " ".join(str(error).split()))
            continue
        if changes:
            log.warning("%s fills no table, its configuration is its own: %s", path, ", ".join(changes))
        else:
            lines.append(line | {"directory": path.parent})
    return pd.DataFrame(lines)


def metrics_of(runs: pd.DataFrame) -> list[str]:
    """The names of all metrics that some run has."""
    return [column.removesuffix("_low") for column in runs.columns if column.endswith("_low")]


def summary(runs: pd.DataFrame) -> pd.DataFrame:
    """Every row that was run: cost, and each test metric, mean over seeds, ± standard deviation where there are several."""
    finished = runs[runs["error"].isna()] if len(runs) else runs
    rows = []
    for choice, found in (
        finished.groupby(["scenario", "split", "model", "ablation", "positions", "size"]) if len(finished) else []
    ):
        line = {"run": " ".join(str(name) for name in choice), "seeds": str(len(found))}
        line["training (s)"] = f"{found['training_seconds'].mean():.0f}"
        line |= {metric.replace("_", " "): _show(found[metric].dropna()) for metric in metrics_of(found)}
        rows.append(line)
    return pd.DataFrame(rows)


def _show(values: "pd.Series[float]") -> str:
    if values.empty:
        return "—"
    return f"{values.mean():.3f}" if len(values) == 1 else f"{values.mean():.3f} ± {values.std():.3f}"


def _read(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_bytes())
    line = {name: content[name] for name in (*NAMES, *COUNTS)} | {"error": None}
    for name, value in content["metrics"].items():
        low, high = content["intervals"][name]
        line |= {name: float(value), f"{name}_low": float(low), f"{name}_high": float(high)}
    return line


def _failure(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_bytes())
    return {name: content[name] for name in (*NAMES, "error")}


def _plain(config: Any, key: str) -> Any:
    node = OmegaConf.select(config, key)
    return OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node


def _differences(key: str, own: Any, expected: Any) -> list[str]:
    if isinstance(own, dict) and isinstance(expected, dict):
        inside = sorted(own.keys() | expected.keys())
        return [found for name in inside for found in _differences(f"{key}.{name}", own.get(name), expected.get(name))]
    return [] if own == expected else [f"{key}={own}"]
