"""Errors by difficulty, do-operation and cell: on which experiments a model fails."""

import logging
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import torch

from cophy.bootstrap import Ratio, interval, mean
from cophy.dataset.difficulty import difficulty
from cophy.dataset.feed.batches import to_batch
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import Part
from cophy.report.figures import row_name
from cophy.report.runs.comparable import of_seeds
from cophy.training.measures.metrics import mean_squared_error
from cophy.training.measures.twin_metrics import twin_difference
from cophy.training.runs.results import read_predictions
from cophy.types import Prediction, Targets

log = logging.getLogger(__name__)

SECTION = ("scenario", "split", "positions", "size")
ALL = "all"
NAMED = {"cell": "cell", "twins": "cells of both twins", "do_operation": "do-operation"}
OF_PAIRS = (ALL, "twins")  # groups for which the share of the twins' difference that is explained is given too
NUMBERS = {
    "displacement": "displacement (m)",
    "observed_difference": "AB: distance from the twin's (m)",
    "counterfactual_difference": "CD: distance from the twin's (m)",
    "observed_margin": "A: margin of the tower (m)",
    "counterfactual_margin": "C: margin of the tower (m)",
}
WORDS = {ALL: "all", **NAMED, **NUMBERS}
RELATIVE_MSE_TOLERANCE = 1e-4  # float32, summed in another order


def mse_by_difficulty(runs: pd.DataFrame, arrays: dict[str, np.ndarray], spec: DatasetSpec, part: Part) -> pd.DataFrame:
    """Break the test MSE of runs down by what makes an experiment hard.

    Args:
        runs: Finished predictors (see `read_runs`) that were tested on this part of the dataset. One whose predictions
            are of something else, or of a part, is left out; the log names it. Of a row, those of `of_seeds` count.
        arrays: The dataset.
        spec: Its description.
        part: The part that is tested on.

    Returns:
        One line per row of a table and group of experiments: experiments, seeds, mse (m²), low and high of its interval.
        Where groups hold whole twin pairs (OF_PAIRS): explained, explained_low and explained_high, shares of the twins'
        difference; NaN elsewhere.
    """
    tested = part.select_split(arrays, "test")
    chosen = {name: array[tested] for name, array in arrays.items()}
    truth, lines = to_batch(chosen, spec.scenario).targets, []
    told = difficulty(arrays, spec)
    values = {name: told[name][tested] for name in WORDS if name in told}
    for keys, found in runs.groupby([*SECTION, "model", "ablation"]):
        each = [error for run in of_seeds(found).to_dict("records") if (error := _errors(run, truth, spec)) is not None]
        if not each:
            continue
        names = [str(key) for key in keys]
        section = dict(zip(SECTION, names, strict=False)) | {"row": row_name(*names[-2:])}
        errors, twin_error, twin_size = np.mean(each, axis=0)
        for by, group, rows in groups(values):
            low, high = interval(errors[rows], chosen["twin"][rows])
            counts = {"experiments": int(rows.sum()), "seeds": len(each)}
            numbers = {"mse": mean(errors[rows]), "low": low, "high": high}
            if by in OF_PAIRS:
                explained = Ratio(twin_size[rows] - twin_error[rows], twin_size[rows])
                ends = interval(explained, chosen["twin"][rows])
                numbers |= {"explained": mean(explained), "explained_low": ends[0], "explained_high": ends[1]}
            lines.append({**section, "by": by, "group": group, **counts, **numbers})
    return pd.DataFrame(lines)


def groups(values: dict[str, np.ndarray]) -> Iterator[tuple[str, str, np.ndarray]]:
    """(by, name of the group, (experiment,) bool): all experiments, then those of each name, and thirds of each number.

    Equal numbers stay together, experiments without the number (NaN) are in no group, and empty groups are left out.
    """
    yield ALL, ALL, np.ones(len(next(iter(values.values()))), dtype=bool)
    for by, value in values.items():
        found = _of_each_name(value) if by in NAMED else _thirds(value)
        yield from ((by, name, rows) for name, rows in found if rows.any())


def _of_each_name(value: np.ndarray) -> list[tuple[str, np.ndarray]]:
    names = np.unique(value).tolist()
    return [(name.replace("_", " "), value == name) for name in names] if len(names) > 1 else []


def _thirds(value: np.ndarray) -> list[tuple[str, np.ndarray]]:
    known = ~np.isnan(value)
    edges = np.quantile(value[known], np.arange(4) / 3) if known.any() else np.full(4, np.nan)
    third = np.searchsorted(edges[1:3], value)
    return [(f"{edges[k]:.3g} to {edges[k + 1]:.3g}", known & (third == k)) for k in range(3)]


def _errors(run: dict[Any, Any], truth: Targets, spec: DatasetSpec) -> np.ndarray | None:
    """(3, experiment) of one run: MSE, and error and size of the twins' difference (see `TwinDifference`). None where its predictions are not of this whole test split, or not those it was judged by."""
    directory = run["directory"]
    found = read_predictions(directory)
    asked, all_of_them = len(found["target"]), len(truth.position)
    if spec.id not in run["dataset_ids"] or not (
        np.array_equal(found["target"], truth.position[:asked])
        and np.array_equal(found["presence"], truth.presence[:asked])
    ):
        log.error("%s: its predictions are not of the test split of %s: make that run again", directory, spec.id)
        return None
    if asked < all_of_them:  # an oracle, whose groups would hold other experiments than those of the models
        log.info("%s: not broken down by difficulty, as it was asked about %d of %d test experiments",
                 directory, asked, all_of_them)  # fmt: skip
        return None
    by_chance = torch.from_numpy(found["draw_variance"]) if "draw_variance" in found else None
    prediction = Prediction(torch.from_numpy(found["position"]), draw_variance=by_chance)
    dims = spec.scenario.task.metric_dims
    errors = mean_squared_error(dims)(prediction, truth).double().numpy()
    if not np.isclose(errors.mean(), run["mse"], rtol=RELATIVE_MSE_TOLERANCE):
        log.error("%s: its predictions have MSE %.6f, its metrics.json says %.6f: make that run again",
                  directory, errors.mean(), run["mse"])  # fmt: skip
        return None
    of_twins = twin_difference(prediction, truth, dims)
    return np.stack([errors, of_twins.error.numpy(), of_twins.size.numpy()])
