"""Tables of docs/results from docs/results/results.csv: python benchmarks/results/result_tables.py [size [table.csv]]

Prints, for every split, the rows whose settings are those of conf/ but for the learning rate, which is named where it is another,
as Markdown: MSE in m² with its 95 % interval and, over several seeds, its standard deviation; the paper's number; share of the
possible gain; what it makes of twins; seconds of training.
"""

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import pandas as pd
from keep_results import TABLE

from cophy.report.paper_tables import published_mse

ROWS = {  # model and ablation, as the tables of the paper name them
    ("copy_c", "full"): "copy C",
    ("copy_b", "full"): "copy B",
    ("in", "full"): "IN",
    ("npe", "full"): "NPE",
    ("cophynet", "full"): "CoPhyNet",
    ("alongside", "full"): "alongside (ours)",
    ("alongside_noisy", "full"): "alongside, noise (ours)",
    ("cophynet", "feedforward"): "CoPhyNet, feedforward",
    ("in", "gt_confounders"): "IN sup.",
    ("oracle_feedforward", "full"): "oracle without AB",
    ("oracle_initial_velocity", "full"): "… initial velocity given",
    ("oracle_confounders", "full"): "… confounders given",
    ("oracle_counterfactual", "full"): "oracle with AB",
}
SPLIT = ["scenario", "split"]
NAMES = [*SPLIT, "model", "ablation", "positions"]
SEEDS_SHARE = ["datasets", "max_epochs"]


def main(size: str, table: Path) -> None:
    """Print."""
    runs = pd.read_csv(table, keep_default_na=False, na_values=[""])
    variant = runs["variant"].fillna("")
    runs["rate"] = variant.str.extract(r"\+learning_rate-([\d.]+)", expand=False).fillna("")
    shown = variant.str.fullmatch(rf"(\+size-{size})?(\+learning_rate-[\d.]+)?")
    kept = runs[shown & (runs["size"] == size) & (runs["positions"] == "ground_truth")]
    if kept.empty:
        sys.exit(f"{table}: no runs of size={size}; there are {', '.join(sorted(set(runs['size'])))}")
    check_seeds(kept, [*NAMES, "variant"])
    for (scenario, split), tested in kept.groupby(SPLIT):
        rows = tested.groupby(["model", "ablation", "rate"])
        lines = [
            line_of(f"{title}, learning rate {rate}" if rate else title, rows.get_group((*name, rate)))
            for name, title in ROWS.items()
            for rate in sorted(set(tested["rate"]))
            if (*name, rate) in rows.groups
        ]
        counts = tested[~tested["model"].str.startswith("oracle")].iloc[0]
        print(
            f"\n### {scenario}, {split}\n\n{counts['num_train']} training and {counts['num_test']} test experiments.\n"
        )
        print(pd.DataFrame(lines).to_markdown(index=False, disable_numparse=True))


def check_seeds(runs: pd.DataFrame, names: list[str]) -> None:
    """Runs of these names are averaged: they must be of the same data and epochs."""
    kinds = runs.groupby(names, dropna=False)[SEEDS_SHARE].nunique().max(axis=1)
    if (mixed := kinds[kinds > 1]).any():
        sys.exit(
            f"runs of several datasets or epochs cannot be averaged, take the older ones out of the table: {list(mixed.index)}"
        )


def line_of(title: str, found: pd.DataFrame) -> dict[str, str]:
    """A row of a table: means over seeds."""
    paper = published_mse({name: found[name].iloc[0] for name in NAMES})
    learns = not found["model"].iloc[0].startswith(("copy", "oracle"))
    seconds = found.loc[found["training_seconds"] > 0, "training_seconds"]
    return {
        "": title,
        "MSE": of(found, "mse", 1, 3),
        "paper": "–" if paper is None else f"{paper:.3f}",
        "share": of(found, "share", 100, 0),
        "twin difference explained": of(found, "twin_difference_explained", 100, 0),
        "right twin chosen": of(found, "right_twin_chosen", 100, 0),
        "seeds": f"{len(found)}" if learns else "–",
        "seconds": f"{seconds.mean():.0f}" if len(seconds) else "–",
    }


def of(found: pd.DataFrame, measure: str, scale: int, digits: int) -> str:
    """Mean, standard deviation where there are several seeds, and the mean of the intervals; of which seeds, if not of all."""
    value, low, high = (scale * found[f"{measure}{end}"].mean() for end in ("", "_low", "_high"))
    if pd.isna(value):
        return "–"
    unit = " %" if scale == 100 else ""
    spread = f" ± {scale * found[measure].std():.{digits}f}" if found[measure].nunique() > 1 else ""
    ends = "" if low == high or pd.isna(low) else f" [{low:.{digits}f}, {high:.{digits}f}]"
    has = found[measure].notna()
    seeds = "" if has.all() else f", seed {', '.join(map(str, sorted(found.loc[has, 'seed'])))}"
    return f"{value:.{digits}f}{spread}{unit}{ends}{seeds}"


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("size", nargs="?", default="small", help="of the data")
    parser.add_argument("table", nargs="?", type=Path, default=TABLE, help="that keep_results.py wrote")
    main(**vars(parser.parse_args()))
