"""Share of towers whose CD stands, for every value of each confounder (the paper's stability distribution)."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cophy.report.colors import BLUE, GREY
from cophy.scenario.search.towers import TOWER_CELLS

EVEN_SHARE = (45, 55)  # %, in grey


def draw_stability_distribution(datasets: dict[int, dict[str, np.ndarray]]) -> Figure:
    """Bars per value. Masses and frictions: one combination per bar, blocks from the bottom up.

    datasets: towers, arrays per number of blocks.
    """
    figure = Figure(figsize=(15, 3.4 * len(datasets)), layout="constrained")
    axes = figure.subplots(len(datasets), 4, squeeze=False, sharey=True, width_ratios=[4, 4, 1, 1])
    standing = np.array([cell.counterfactual for cell in TOWER_CELLS])
    for row, (count, arrays) in zip(axes, sorted(datasets.items()), strict=True):
        for axis, (name, value) in zip(row, _values(arrays, count).items(), strict=True):
            share = 100 * pd.Series(standing[arrays["cell"]]).groupby(value).mean()
            at = np.arange(len(share))
            axis.bar(at, share, color=BLUE, label="CD stands")
            axis.bar(at, 100 - share, bottom=share, color=GREY, label="CD falls")
            axis.set_xticks(at, share.index)
            axis.axhspan(*EVEN_SHARE, color="k", alpha=0.12, lw=0)
            axis.set_title(f"{name}, K = {count}" if len(share) > 3 else name, fontsize="medium")
            axis.set_ylim(0, 100)
            axis.tick_params(axis="x", rotation=90 if len(share) > 3 else 0, labelsize="small")
        row[0].set_ylabel("experiments, %")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False)
    return figure


def _values(arrays: dict[str, np.ndarray], num_blocks: int) -> dict[str, np.ndarray]:
    """(experiment,) what each confounder is, as text."""
    height = np.where(arrays["presence"][:, 0], arrays["states"][:, 0, 0, :, 2], np.inf)
    blocks = height.argsort(axis=1)[:, :num_blocks]
    return {
        "mass, kg": _combinations(np.take_along_axis(arrays["mass"], blocks, axis=1)),
        "friction": _combinations(np.take_along_axis(arrays["friction"], blocks, axis=1)),
        "gravity x, m/s²": _combinations(arrays["gravity"][:, :1]),
        "gravity y, m/s²": _combinations(arrays["gravity"][:, 1:2]),
    }


def _combinations(values: np.ndarray) -> np.ndarray:
    return np.array([" ".join(f"{value:g}" for value in row) for row in values])
