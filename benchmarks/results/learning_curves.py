"""What more data bring: python benchmarks/results/learning_curves.py [table.csv [folder]]

Draws a picture per scenario, learning-curves-<scenario>.png: MSE, share of the possible gain and twin difference explained over the
number of training experiments. It is of every row of docs/results/results.csv that was trained on several numbers
(training.num_experiments=, size=), with its other settings as conf/ has them. Prints the numbers as a Markdown table.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from keep_results import ROOT, TABLE
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, ScalarFormatter
from result_tables import ROWS, check_seeds

FIGURES = ROOT / "docs" / "figures"
PANEL = ["scenario", "split"]
CURVE = [*PANEL, "model", "ablation"]
MEASURES = {  # with their titles, and what they are multiplied by
    "mse": ("test MSE, m²", 1),
    "share": ("share of the possible gain, %", 100),
    "twin_difference_explained": ("twin difference explained, %", 100),
}
COLUMNS = [f"{measure}{end}" for measure in MEASURES for end in ("", "_low", "_high")]
SIZES = ["small", "12k", "paper"]  # from few experiments to many
ENOUGH = 3  # points
PLAIN = r"(\+size-\w+)?(\+num_experiments-\d+)?"  # what may differ from conf/


def main(table: Path, folder: Path) -> None:
    """Print and draw."""
    found = mean_over_seeds(pd.read_csv(table))
    curves = found[found.groupby(CURVE)["num_train"].transform("nunique") >= ENOUGH]
    shown = curves[[*CURVE, "num_train", "size", "seeds", *MEASURES]]
    print(shown.to_markdown(index=False, floatfmt=("",) * 7 + (".3f", ".2f", ".2f")))
    for scenario, of_scenario in curves.groupby("scenario"):
        draw(of_scenario).savefig(folder / f"learning-curves-{scenario}.png", dpi=120)


def mean_over_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """A line per curve and number of experiments: the means of its measures and of their intervals, and its seeds.

    Runs that change more than the number of experiments are left out.
    """
    plain = runs["variant"].fillna("").str.fullmatch(PLAIN) & (runs["positions"] == "ground_truth")
    kept = runs[plain & runs["size"].isin(SIZES)]
    check_seeds(kept, [*CURVE, "num_train", "size"])
    points = kept.groupby([*CURVE, "num_train", "size"])
    found = points[COLUMNS].mean().assign(seeds=points["seed"].agg(lambda seeds: ", ".join(map(str, sorted(seeds)))))
    curves = [of_few_datasets(curve) for _, curve in found.reset_index().groupby(CURVE)]
    return pd.concat(curves, ignore_index=True)


def of_few_datasets(curve: pd.DataFrame) -> pd.DataFrame:
    """The points of the largest dataset where it has enough for a curve; else those of all, the larger dataset's first.

    Each dataset has its own test split, so a curve of one is smoother.
    """
    ordered = curve.assign(order=curve["size"].map(SIZES.index)).sort_values(["num_train", "order"])
    largest = ordered[ordered["order"] == ordered["order"].max()]
    return largest if len(largest) >= ENOUGH else ordered.drop_duplicates("num_train", keep="last")


def draw(curves: pd.DataFrame) -> Figure:
    """A row of panels per split, a panel per measure; bands are 95 % intervals."""
    splits = list(curves.groupby("split"))
    measures = {name: shown for name, shown in MEASURES.items() if curves[name].notna().any()}
    figure, axes = plt.subplots(
        len(splits), len(measures), figsize=(4 * len(measures), 3.2 * len(splits)), squeeze=False, layout="constrained"
    )
    named: dict[str, Line2D] = {}
    for row, (split, of_split) in zip(axes, splits, strict=True):
        for axis, (measure, (title, scale)) in zip(row, measures.items(), strict=True):
            for (model, ablation), line in of_split.groupby(["model", "ablation"]):
                name = (str(model), str(ablation))
                color = f"C{list(ROWS).index(name)}"
                (drawn,) = axis.plot(line["num_train"], scale * line[measure], marker="o", color=color)
                named[ROWS[name]] = drawn
                low, high = (scale * line[f"{measure}_{end}"] for end in ("low", "high"))
                axis.fill_between(line["num_train"], low, high, color=color, alpha=0.15)
            axis.set(xscale="log", title=title, xlabel="training experiments")
            axis.xaxis.set_major_formatter(ScalarFormatter())
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.set_xticks(sorted(of_split["num_train"].unique()))
            axis.set_ylim(bottom=0 if measure == "mse" else None)
        row[0].set_ylabel(f"{curves['scenario'].iloc[0]}, {split}")
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=len(named), frameon=False)
    return figure


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("table", nargs="?", type=Path, default=TABLE, help="that keep_results.py wrote")
    parser.add_argument("folder", nargs="?", type=Path, default=FIGURES, help="where the pictures go")
    main(**vars(parser.parse_args()))
