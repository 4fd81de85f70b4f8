"""What a run left, read with care: a file that is not what train.py writes is an error that says why."""

import json
import math
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf

from cophy.errors import CophyError
from cophy.training.runs.identity import FAILURE
from cophy.training.runs.results import read_predictions

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
