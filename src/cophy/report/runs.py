"""outputs/ -> one line per finished run, each checked to be what its name says."""

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
COUNTS = ("num_train", "num_test", "wall_seconds")


def read_runs(outputs: Path, configuration_of: Callable[[dict[str, Any]], dict[str, Any]]) -> pd.DataFrame:
    """Finished runs, one line each: names, counts, epochs and every test metric.

    configuration_of: from a run's names to the model, scenario and split that they stand for. A run whose own
    configuration differs (an override on the command line beats a row's setting) fills no table; the log names it.
    """
    lines = []
    for path in sorted(outputs.rglob("metrics.json")):
        try:
            line = _read(path)
            own: Any = OmegaConf.load(path.parent / ".hydra" / "config.yaml")
            expected = configuration_of(line)
            changes = [
                change for part in expected for change in _differences(f"{part}.", _plain(own[part]), expected[part])
            ]
            line["epochs"] = int(own.trainer.max_epochs)
        except (ValueError, KeyError, TypeError, OSError, OmegaConfBaseException, HydraException, YAMLError) as error:
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


def _plain(node: Any) -> Any:
    return OmegaConf.to_container(node, resolve=True)


def _differences(prefix: str, own: Any, expected: Any) -> list[str]:
    if isinstance(own, dict) and isinstance(expected, dict):
        keys = sorted(own.keys() | expected.keys())
        return [found for key in keys for found in _differences(f"{prefix}{key}.", own.get(key), expected.get(key))]
    return [] if own == expected else [f"{prefix.rstrip('.')}={own}"]
