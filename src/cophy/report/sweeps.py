"""Sweeps: runs of one method that differ in changed keys, as a table and a figure of MSE over key."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cophy.atomic_files import read_plain
from cophy.report.methods import METHOD, TABLE, VALIDATION, listed, measured_cell, method_title, natural, table_name
from cophy.report.render import UNCERTAINTY, TextTable
from cophy.training.run import flatten, short_keys

CONFIG = Path(".hydra") / "config.yaml"  # in the directory of a run
MEASURES = {VALIDATION: "validation", "mse": "test"}
STYLES = {VALIDATION: ("#d55e00", "--"), "mse": ("#0072b2", "-")}  # of Okabe and Ito, for the colour-blind
DECADE = 10  # a key whose values span it has a logarithmic axis
PANEL_IN = (3.6, 3.0)  # width and height, inches
TICK_DISTANCE = 0.1  # as a part of the axis
BEST, OTHERS = "lowest validation MSE", "other settings"
UNCHANGED = "default"  # in place of a value that the configuration does not tell


@dataclass(frozen=True)
class Sweep:
    """The settings of one method on one split.

    Attributes:
        title: Method, data and split.
        name: The same, in names of files.
        settings: Lines of `method_cells` with a column for each key of `keys`, which has its values as text.
        keys: Swept keys, in whole.
    """

    title: str
    name: str
    settings: pd.DataFrame
    keys: tuple[str, ...]

    @property
    def best(self) -> Any:
        """The index of the setting with the lowest validation MSE; None where fewer than two were validated."""
        validated = self.settings[f"metrics.{VALIDATION}"].dropna()
        return validated.idxmin() if len(validated) > 1 else None


def find_sweeps(cells: pd.DataFrame) -> Iterator[Sweep]:
    """Yield the sweeps among all runs: methods with several settings on a split.

    Args:
        cells: See `method_cells`.
    """
    for _, settings in cells.groupby([*TABLE, "column", *METHOD[:2]]):
        if len(settings) < 2 or not settings["seeds"].any():
            continue
        changes = settings["changes"]
        every = dict.fromkeys(key for changed in changes for key in changed)
        keys = tuple(key for key in every if len({changed.get(key) for changed in changes}) > 1)
        first = settings.iloc[0]
        values = {
            key: [_value(changed, key, path) for changed, path in zip(changes, settings["directory"], strict=True)]
            for key in keys
        }
        shared = {key: value for key, value in first["changes"].items() if key not in keys}
        title = f"Sweep of {method_title(first['model'], first['ablation'], shared)}, {table_name(first)}, {first['column']}"
        parts = filter(None, (first[name] for name in (*TABLE, "column", "model", "ablation")))
        swept = settings.assign(**values)
        order = sorted(swept.index, key=lambda index: [natural(swept.loc[index, key]) for key in keys])
        yield Sweep(title, re.sub(r"[^\w.-]+", "_", "-".join(parts)), swept.loc[order], keys)


def _value(changed: dict[str, str], key: str, directory: Path) -> str:
    """Return the value of a key as text; where a run does not change it, the one in its configuration."""
    if key in changed:
        return changed[key]
    values = {str(value) for name, value in _configuration(directory).items() if name.endswith(f".{key}")}
    values = {text for text in values if "${" not in text}
    return values.pop() if len(values) == 1 else UNCHANGED


@cache
def _configuration(directory: Path) -> dict[str, Any]:
    """Return the keys of a run's configuration with their values; none if the file is missing or damaged."""
    try:
        text = read_plain(directory / CONFIG)
        # nothing of Hydra's is an alias, and aliases of aliases may unfold without end
        is_plain = not any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, yaml.SafeLoader))
        return flatten({"": yaml.safe_load(text)}) if is_plain else {}
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return {}


def sweep_table(sweep: Sweep) -> TextTable:
    """Return a table with validation and test MSE of every setting, the best by validation marked."""
    lines = sweep.settings.to_dict("index")
    labels = [", ".join(line[key] for key in sweep.keys) for line in lines.values()]
    index = pd.Index(labels, name=", ".join(short_keys(sweep.keys).values()))
    columns = {}
    for metric, title in MEASURES.items():
        cells = {at: measured_cell(line, metric) for at, line in lines.items()}
        if sweep.best is not None:
            marked = cells[sweep.best]
            cells[sweep.best] = marked._replace(ours=f"{marked.ours}*", best=True)
        columns[f"{title} MSE (m²)"] = pd.Series([*cells.values()], index, dtype=object)
    done = sweep.settings[sweep.settings["seeds"] > 0]
    counts = [listed(done[name]) for name in ("num_train", "num_test", "seeds")]
    mark = "*: lowest validation MSE. " if sweep.best is not None else ""
    note = f"{mark}{counts[0]} training and {counts[1]} test experiments; training seeds: {counts[2]}."
    return TextTable(f"sweep-{sweep.name}", sweep.title, pd.DataFrame(columns), f"{note} {UNCERTAINTY}.", note)


def draw_sweep(sweep: Sweep) -> Figure | None:
    """Draw MSE over each numeric key: all settings as points, a line where the other keys are fixed, at the best by validation.

    Returns:
        None where no key is numeric.
    """
    done = sweep.settings[sweep.settings["seeds"] > 0]
    numeric = {key: values for key in sweep.keys if (values := pd.to_numeric(done[key], errors="coerce")).nunique() > 1}
    if not numeric:
        return None
    width, height = PANEL_IN
    figure = Figure(figsize=(width * len(numeric) + 0.4, height), layout="constrained")
    panels: Sequence[Axes] = figure.subplots(1, len(numeric), sharey=True, squeeze=False)[0]
    for axis, (key, values) in zip(panels, numeric.items(), strict=True):
        is_slice = _best_slice(done.assign(at=values).dropna(subset="at"), [name for name in sweep.keys if name != key])
        for metric in MEASURES:
            if done[f"metrics.{metric}"].notna().any():
                _draw_measure(axis, metric, done, values, is_slice)
        known = values.dropna()
        if known.min() > 0 and known.max() >= DECADE * known.min():
            axis.set_xscale("log")
        ticks = _ticks(sorted(known.unique()), is_log=axis.get_xscale() == "log")
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        if sweep.best in known.index:
            best = done.loc[sweep.best, [f"metrics.{metric}" for metric in MEASURES]]
            axis.plot([known[sweep.best]] * len(best), best, "o", ms=9, mfc="none", mec="k", label=BEST)
        axis.set_xlabel(short_keys(sweep.keys)[key])
        axis.grid(alpha=0.2)
    panels[0].set_ylabel("MSE (m²)")
    handles = {
        label: handle for axis in panels for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    if any(line.get_label() == OTHERS for axis in panels for line in axis.lines):
        handles |= {OTHERS: Line2D([], [], ls="", marker="o", color="0.5", ms=3)}
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=2, frameon=False, fontsize="small"
    )
    figure.suptitle(sweep.title, fontsize="small", wrap=True)
    return figure


def _ticks(values: list[float], *, is_log: bool) -> list[float]:
    """Return the values that have room for a number below an axis, from the first on."""
    at = np.log(values) if is_log else np.asarray(values)
    kept = [0]
    for n in range(1, len(at)):
        if at[n] - at[kept[-1]] >= TICK_DISTANCE * (at[-1] - at[0]):
            kept.append(n)
    return [values[n] for n in kept]


def _best_slice(settings: pd.DataFrame, others: list[str]) -> "pd.Index[Any]":
    """Return the index of the settings that agree in all other keys and have the best MSE of validation, at two values or more."""
    slices = [of_slice for _, of_slice in settings.groupby(others)] if others else [settings]
    metric = f"metrics.{VALIDATION if settings[f'metrics.{VALIDATION}'].notna().any() else 'mse'}"
    lines = [of_slice for of_slice in slices if of_slice["at"].nunique() > 1]
    return min(lines, key=lambda of_slice: float(of_slice[metric].min()), default=settings.iloc[:0]).index


def _draw_measure(
    axis: Axes, metric: str, done: pd.DataFrame, values: "pd.Series[float]", is_slice: "pd.Index[Any]"
) -> None:
    color, style = STYLES[metric]
    mean, sd = f"metrics.{metric}", f"sd.{metric}"
    others = done.index.difference(is_slice)
    axis.plot(values[others], done.loc[others, mean], "o", color=color, ms=3, alpha=0.4, label=OTHERS)
    line = done.loc[is_slice].assign(at=values[is_slice]).sort_values("at")
    if len(line) < 2:
        return
    low, high = line[mean] - line[sd], line[mean] + line[sd]
    band = "± sd over seeds"
    if low.isna().all() and f"low.{metric}" in line:
        low, high, band = line[f"low.{metric}"], line[f"high.{metric}"], "95 % interval"
    has_band = low.notna().any()
    axis.plot(
        line["at"],
        line[mean],
        style,
        marker="o",
        ms=4,
        color=color,
        label=f"{MEASURES[metric]}{f', {band}' if has_band else ''}",
    )
    if has_band:
        axis.fill_between(line["at"], low, high, color=color, alpha=0.15, lw=0)
