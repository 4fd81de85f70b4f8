"""outputs/ -> one line per finished run, each checked to be what its name says."""

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

log = logging.getLogger(__name__)

NAMES = ("scenario", "split", "model", "ablation", "positions", "seed", "size")
COUNTS = ("num_train", "num_test", "wall_seconds")


def read_runs(outputs: Path, model_of: Callable[[dict[str, Any]], dict[str, Any]]) -> pd.DataFrame:
    """Finished runs, one line each: names, counts and every test metric.

    model_of: from a run's names to the model configuration that they stand for. A run whose own configuration differs
    (an override on the command line beats a row's setting) fills no table; it is named in the log instead.
    """
    lines = []
    for path in sorted(outputs.rglob("metrics.json")):
        try:
            line = _read(path)
            changes = _differences(_model_configuration(path.parent), model_of(line))
        except (ValueError, KeyError, TypeError, OSError, OmegaConfBaseException, YAMLError) as error:
            log.warning("%s is skipped: %s: %s", path, type(error).__name__, " ".join(str(error).split()))
            continue
        if changes:
            log.warning("%s fills no table, its configuration is its own: %s", path, ", ".join(changes))
        else:
            lines.append(line)
    return pd.DataFrame(lines)


def _read(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_bytes())
    line = {name: content[name] for name in (*NAMES, *COUNTS)}
    return line | {name: float(value) for name, value in content["metrics"].items()}


def _model_configuration(directory: Path) -> dict[str, Any]:
    model = OmegaConf.load(directory / ".hydra" / "config.yaml").model
    container = OmegaConf.to_container(model, resolve=True)
    if not isinstance(container, dict):
        raise TypeError("its .hydra/config.yaml has no model")
    return {str(key): value for key, value in container.items()}


def _differences(own: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    keys = sorted(own.keys() | expected.keys())
    return [f"model.{key}={own.get(key)}" for key in keys if own.get(key) != expected.get(key)]
