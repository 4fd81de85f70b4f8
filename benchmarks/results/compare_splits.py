"""Is a row better on one split than on another? python benchmarks/results/compare_splits.py cophynet 3to3_unseen 3to3_seen [outputs]

A row is a model and what its runs change, as their directories have it: cophynet+max_epochs-55, in+ablation-gt_confounders. A split is that of a run: where runs were trained on, too, not only tested. Splits that
have no experiment in common are joined by +: 3to3_unseen+3to3_seen. Prints a Markdown table with a line for each scenario, kind of
positions and size: the seeds that both have, both MSE (mean over seeds), and their difference with its 95 % interval. Of two splits
that are tested on experiments of one dataset, those in both are compared, one by one; else two samples are, and the interval is
wider.
"""

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import bootstrap

from cophy.bootstrap import NUM_RESAMPLES
from cophy.config import folder
from cophy.report.predictions import stored_scores
from cophy.report.runs import read_line
from cophy.training.run import METRICS

ALIKE = ["scenario", "positions", "size"]  # in both


def main(row: str, split: str, other: str, outputs: Path) -> None:
    """Compare a row on two splits wherever it was run on both."""
    runs = pd.DataFrame([run_of(path) for path in sorted(outputs.glob(f"*/*/*/*/*/seed*/{METRICS}"))])
    runs = runs if runs.empty else runs[runs["name"] == row]
    if runs.empty:
        sys.exit(f"{outputs}: no finished run of {row}")
    lines = [
        dict(zip(ALIKE, alike, strict=True)) | line
        for alike, found in runs.groupby(ALIKE)
        if (line := compared(found, split.split("+"), other.split("+")))
    ]
    if not lines:
        sys.exit(f"{outputs}: no seed of {row} was run on both {split} and {other}")
    print(pd.DataFrame(lines).to_markdown(index=False, floatfmt=".3f"))


def run_of(path: Path) -> dict[str, object]:
    """Return the line of a run, with the name of its row."""
    line = read_line(path)
    ablation = "" if line["ablation"] == "full" else f"+ablation-{line['ablation']}"
    variant = line["variant"].replace(f"+size-{line['size']}", "")
    return line | {"name": f"{line['model']}{ablation}{variant}"}


def compared(runs: pd.DataFrame, splits: list[str], others: list[str]) -> dict[str, object]:
    """The difference between two splits; nothing where no seed was run on both."""
    seeds = sorted(set.intersection(*(set(runs[runs["split"] == each]["seed"]) for each in splits + others)))
    if not seeds:
        return {}
    one, two = (errors(runs[runs["seed"].isin(seeds)], names) for names in (splits, others))
    shared = one.index.intersection(two.index)
    if len(shared):
        one, two = one[shared], two[shared]
    low, high = interval(one, two, paired=len(shared) > 0)
    return {
        "seeds": ", ".join(map(str, seeds)),
        "clusters": f"{len(shared)} in both" if len(shared) else f"{len(one)}, {len(two)}",
        "MSE": one.mean(),
        "on the other": two.mean(),
        "difference": f"{one.mean() - two.mean():.3f} [{low:.3f}, {high:.3f}]",
    }


def errors(runs: pd.DataFrame, splits: list[str]) -> pd.Series:
    """The MSE of every cluster of some splits, mean over experiments and seeds; its index are test dataset and cluster."""
    found = [
        pd.Series(scores.mse).groupby([pd.Index([run["dataset_ids"][-1]] * len(scores.cluster)), scores.cluster]).mean()
        for run in runs[runs["split"].isin(splits)].to_dict("records")
        for scores in [stored_scores(run)]
    ]
    return pd.concat(found).groupby(level=[0, 1]).mean()


def interval(one: pd.Series, two: pd.Series, *, paired: bool) -> tuple[float, float]:
    """Bootstrap 95 % interval of the difference of two means over clusters (percentiles; the same at every call)."""
    found = bootstrap(
        (one.to_numpy(), two.to_numpy()),
        lambda ours, others, axis: ours.mean(axis=axis) - others.mean(axis=axis),
        n_resamples=NUM_RESAMPLES,
        method="percentile",
        paired=paired,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("row", help="a model, and what a run changes beyond it")
    parser.add_argument("split", help="or splits, joined by +")
    parser.add_argument("other", help="likewise")
    parser.add_argument(
        "outputs", nargs="?", type=Path, default=Path(folder("COPHY_OUTPUTS")), help="where runs are kept"
    )
    main(**vars(parser.parse_args()))
