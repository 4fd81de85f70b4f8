"""What more data bring: python benchmarks/learning_curves.py [table.csv [picture.png]]

Draws the test MSE over the number of training experiments, for every row of docs/results/results.csv that was trained on several
numbers (training.num_experiments=, size=), with its other settings as conf/ has them. Prints the numbers as a Markdown table.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from keep_results import TABLE
from matplotlib.ticker import NullFormatter, ScalarFormatter
from measure import ROOT

PANEL = ["scenario", "split"]
CURVE = [*PANEL, "model", "ablation"]
PICTURE = ROOT / "docs" / "pictures" / "learning-curves.png"
SIZES = ["small", "12k", "paper"]
PLAIN = r"(\+size-\w+)?(\+num_experiments-\d+)?"  # what may differ from conf/


def main(table: Path, picture: Path) -> None:
    """Print and draw."""
    runs = pd.read_csv(table)
    found = mean_over_seeds(runs[runs["size"].isin(SIZES) & (runs["positions"] == "ground_truth")])
    curves = found[found.groupby(CURVE)["num_train"].transform("nunique") > 1]
    print(curves.drop(columns=["low", "high"]).to_markdown(index=False, floatfmt=("", "", "", "", "", ".3f", ".2f")))
    panels = list(curves.groupby(PANEL))
    figure, axes = plt.subplots(1, len(panels), figsize=(4 * len(panels), 3.2), squeeze=False, layout="constrained")
    for axis, ((scenario, split), panel) in zip(axes[0], panels, strict=True):
        for (model, ablation), line in panel.groupby(["model", "ablation"]):
            label = model if ablation == "full" else f"{model}, {ablation}"
            (drawn,) = axis.plot(line["num_train"], line["mse"], marker="o", label=label)
            axis.fill_between(line["num_train"], line["low"], line["high"], color=drawn.get_color(), alpha=0.15)
        axis.set(
            xscale="log",
            title=f"{scenario}, {split}",
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

    Runs that change more than the number of experiments are left out.
    """
    kept = runs[runs["variant"].fillna("").str.fullmatch(PLAIN)]
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
    if len(sys.argv) > 3 or "--help" in sys.argv:
        sys.exit(str(__doc__))
    given = dict(enumerate(sys.argv))
    main(Path(given.get(1, TABLE)), Path(given.get(2, PICTURE)))
