"""Seconds of report.py over 790 runs: the names and metrics of docs/results/format_3.csv, and random predictions."""

import json
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from measure import ROOT, Measured
from speed_startup import cpu_seconds_of

from cophy.commands.report import ComposedData
from cophy.config import folder
from cophy.report.predictions import scores_of
from cophy.scenario import Scenario
from cophy.training.run import METRICS, Run, write_predictions

NUM_TEST = 4  # experiments that every run predicts, as at size=tiny
REPEATS = 3


def measure() -> list[Measured]:
    """Measure a report of a folder that is written first."""
    with tempfile.TemporaryDirectory() as directory:
        write_runs(Path(directory))
        times, cpu_seconds = [time.perf_counter()], list[float]()
        for _ in range(REPEATS):
            cpu_seconds.append(cpu_seconds_of("report.py", f"outputs={directory}"))
            times.append(time.perf_counter())
    seconds = np.diff(times).tolist()
    return [Measured("report.py over 790 runs", "s", seconds, "≤ 15"), Measured("the same", "CPU-s", cpu_seconds)]


def write_runs(outputs: Path) -> None:
    """Write metrics.json and predictions.npz of all runs in docs/results/format_3.csv."""
    data = ComposedData("generated", Path(folder("COPHY_DATA")))
    runs = pd.read_csv(ROOT / "docs" / "results" / "format_3.csv")
    columns = [str(column) for column in runs]
    metrics = [column.removesuffix("_low") for column in columns if column.endswith("_low") and column != "share_low"]
    for line in runs.to_dict("records"):
        names = {name: line[name] for name in ("scenario", "split", "model", "ablation", "positions", "seed")}
        size = line["size"] if line["size"] in ("small", "paper") else "tiny"
        run = Run(**names, size=size, variant="" if size == "small" else f"+size-{size}", directory=outputs)
        while (directory := outputs / run.place).exists():
            run.seed += 1  # the results also hold runs that change more than their names say
        directory.mkdir(parents=True)
        known, task = [name for name in metrics if not np.isnan(line[name])], data.scenario(run.scenario).task
        facts = {
            "dataset_ids": sorted(data.dataset_ids(run.scenario, size) or ()),
            "derenderer": None,
            "predictor": None,
            "num_train": line["num_train"],
            "num_test": NUM_TEST,
            "max_epochs": 40,
            "metric_dims": task.metric_dims,
            "training_seconds": line["training_seconds"],
            "wall_seconds": 1.0,
            "metrics": {name: line[name] for name in known},
            "intervals": {name: [line[f"{name}_low"], line[f"{name}_high"]] for name in known},
        }
        if run.model != "derenderer":
            mse = _write_predictions(directory, data.scenario(run.scenario), float(np.sqrt(line["mse"])))
            facts["metrics"]["mse"] = mse
        (directory / METRICS).write_text(json.dumps(run.names() | facts))


def _write_predictions(directory: Path, scenario: Scenario, error: float) -> float:
    """Write random predictions with about this root mean squared error, and return their MSE."""
    shape = (NUM_TEST, scenario.clock.num_frames - 1, scenario.num_slots, 3)
    target, noise = (np.random.default_rng(seed).standard_normal(shape, np.float32) for seed in (0, 1))
    rows, presence = np.arange(NUM_TEST), np.ones((NUM_TEST, scenario.num_slots), bool)
    arrays = {
        **{"target": target, "position": target + np.float32(error) * noise, "initial": target[:, 0]},
        **{"presence": presence, "stable": np.zeros(shape[:3], bool)},
        **{"experiment": rows, "pair": rows // 2, "cluster": rows // 2, "cell": np.zeros_like(rows)},
    }
    write_predictions(directory, arrays)
    return float(scores_of(arrays, scenario.task.metric_dims).mse.mean())
