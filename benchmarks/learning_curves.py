"""What more data bring: python benchmarks/learning_curves.py [outputs [picture.png]]

Draws the test MSE over the number of training experiments, for every model that was trained on several
(training.num_experiments=) with its other settings as conf/ has them. Prints the numbers as a Markdown table.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.ticker import NullFormatter, ScalarFormatter

from cophy.report.runs.stored_run import read_line
from cophy.training.runs.identity import METRICS

CURVE = ["scenario", "split", "size", "model"]
ORACLE = "oracle_counterfactual"
PLAIN = r"(\+size-\w+)?(\+num_experiments-\d+)?"  # what may differ from conf/


def main(outputs: Path, picture: Path) -> None:
    """Print and draw."""
    found = mean_over_seeds(
        pd.DataFrame([read_line(path) for path in outputs.glob(f"*/*/*/full/ground_truth/seed*/{METRICS}")])
    )
    several = found.groupby(CURVE)["num_train"].transform("nunique") > 1
    curves, oracles = found[several], found[found["model"] == ORACLE]
    print(
        curves.drop(columns=["low", "high"]).to_markdown(
            index=False, floatfmt=("", "", "", "", ".0f", ".3f", ".2f", "")
        )
    )
    panels = list(curves.groupby(CURVE[:3]))
    figure, axes = plt.subplots(1, len(panels), figsize=(4 * len(panels), 3.2), squeeze=False, layout="constrained")
    for axis, ((scenario, split, size), panel) in zip(axes[0], panels, strict=True):
        for model, line in panel.groupby("model"):
            line = line.sort_values("num_train")
            (drawn,) = axis.plot(line["num_train"], line["mse"], marker="o", label=model)
            axis.fill_between(line["num_train"], line["low"], line["high"], color=drawn.get_color(), alpha=0.15)
        known = oracles[(oracles["scenario"] == scenario) & (oracles["split"] == split) & (oracles["size"] == size)]
        for mse in known["mse"]:
            axis.axhline(mse, color="0.5", linestyle="--", label="oracle with AB")
        axis.set(
            xscale="log",
            title=f"{scenario}, {split}, size={size}",
            xlabel="training experiments",
            ylabel="test MSE, m²",
            ylim=(0, None),
        )
        axis.xaxis.set_major_formatter(ScalarFormatter())
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_xticks(sorted(panel["num_train"].unique()))
        axis.legend(frameon=False)
    figure.savefig(picture, dpi=120)


def mean_over_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """A line per curve and number of experiments: MSE with the mean of its intervals, twin difference explained, seeds.

    Runs that change more than the number of experiments, or were shorter than others, are left out.
    """
    kept = runs[runs["variant"].str.fullmatch(PLAIN)]
    return (
        kept.groupby([*CURVE, "num_train"])
        .agg(
            mse=("mse", "mean"),
            explained=("twin_difference_explained", "mean"),
            seeds=("seed", lambda seeds: ", ".join(map(str, sorted(seeds)))),
            low=("mse_low", "mean"),
            high=("mse_high", "mean"),
        )
        .reset_index()
    )


if __name__ == "__main__":
    if len(sys.argv) > 3:
        sys.exit(str(__doc__))
    given = dict(enumerate(sys.argv))
    main(Path(given.get(1, "outputs")), Path(given.get(2, "learning-curves.png")))
