"""Is one model better than another? python benchmarks/results/compare_rows.py alongside cophynet [outputs]

What a run changes beyond its model is named as its directory has it: cophynet+max_epochs-55; and so is its ablation:
in+ablation-gt_confounders. Where both names end in their positions, these are compared, too: cophynet@derendered cophynet@ground_truth.
Both were tested on the same experiments, so their errors are compared experiment by experiment. Prints a Markdown table with a
line per tested split: the seeds that both have, both MSE (mean over seeds), and their difference with its 95 % interval.
"""

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import pandas as pd

from cophy.bootstrap import interval
from cophy.config import folder
from cophy.report.predictions import stored_scores
from cophy.report.runs import read_line
from cophy.scoring import average, compare, have_same_experiments
from cophy.training.run import METRICS

TESTED = ["scenario", "split", "positions", "size"]  # what both runs share


def main(ours: str, other: str, outputs: Path) -> None:
    """Compare two models wherever both were run."""
    paths = sorted(outputs.glob(f"*/*/*/*/*/seed*/{METRICS}"))
    if not paths:
        sys.exit(f"{outputs}: no finished runs")
    runs, tested_alike = pd.DataFrame([run_of(path) for path in paths]), TESTED
    if "@" in ours and "@" in other:
        runs["name"] += "@" + runs["positions"]
        tested_alike = [each for each in TESTED if each != "positions"]
    if unknown := {ours, other} - set(runs["name"]):
        known = ", ".join(sorted(set(runs["name"])))
        sys.exit(f"{outputs}: no run of {', '.join(sorted(unknown))}; there are {known}")
    lines = [
        dict(zip(tested_alike, tested, strict=True)) | line
        for tested, found in runs.groupby(tested_alike)
        if (line := compared(found[found["name"] == ours], found[found["name"] == other]))
    ]
    print(pd.DataFrame(lines).to_markdown(index=False, floatfmt=".3f"))


def run_of(path: Path) -> dict[str, object]:
    """Return the line of a run, with the name that it has here."""
    line = read_line(path)
    ablation = "" if line["ablation"] == "full" else f"+ablation-{line['ablation']}"
    variant = line["variant"].replace(f"+size-{line['size']}", "")
    return line | {"name": f"{line['model']}{ablation}{variant}"}


def compared(ours: pd.DataFrame, other: pd.DataFrame) -> dict[str, object]:
    """The difference of two rows of a table; nothing where no seed was run with both."""
    seeds = sorted(set(ours["seed"]) & set(other["seed"]))
    scores = [
        [stored_scores(run) for run in rows[rows["seed"].isin(seeds)].to_dict("records")] for rows in (ours, other)
    ]
    if not seeds or not have_same_experiments([each for part in scores for each in part]):
        return {}
    one, two = (average(part) for part in scores)
    difference = compare(one, two)
    low, high = interval(difference.mse, difference.cluster)
    return {
        "epochs": ", ".join(sorted({str(epochs) for rows in (ours, other) for epochs in rows["epochs"]}, key=int)),
        "seeds": ", ".join(map(str, seeds)),
        "MSE": one.mse.mean(),
        "other's": two.mse.mean(),
        "difference": f"{difference.mse.mean():.3f} [{low:.3f}, {high:.3f}]",
    }


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("ours", help="a model, and what a run changes beyond it")
    parser.add_argument("other", help="likewise")
    parser.add_argument(
        "outputs", nargs="?", type=Path, default=Path(folder("COPHY_OUTPUTS")), help="where runs are kept"
    )
    main(**vars(parser.parse_args()))
