"""Results that stay when outputs/ go: python benchmarks/results/keep_results.py [outputs [table.csv]]

Adds every finished run to docs/results/results.csv, with the commit of this checkout, and with its share of the possible gain where
both oracles are among the runs. A run that is in the table already (the same names, data and epochs) is replaced, but no training
by a test of given weights (predictor=), whose commit is that of the test. One that was not made again keeps its commit. Run it
before the code changes: no file of src/ or conf/ may differ from the commit.
"""

import subprocess
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import numpy as np
import pandas as pd

from cophy.atomic_files import write_atomically
from cophy.config import folder
from cophy.report.predictions import stored_scores
from cophy.report.runs import read_line
from cophy.report.tables import share_of_gain
from cophy.training.run import METRICS

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "docs" / "results" / "results.csv"
NAMES = ["scenario", "split", "model", "ablation", "positions", "size", "variant", "seed"]
KEY = [*NAMES, "datasets", "num_train", "max_epochs"]
SAME_RUN = [*KEY, "predictor", "training_seconds", "mse"]  # the seconds of two trainings differ
ENDS = ("oracle_feedforward", "oracle_counterfactual")  # without AB, with AB
DATA_KEYS = r"\+(size|data_seed|max_experiments)-\w+"  # parts of a variant that only say which experiments a run is on
TESTED = ["scenario", "split", "datasets"]  # what a run and the oracles that it is compared with have in common
SHARE = ["share", "share_low", "share_high"]
# paper Table 1: mean of the heights, then from top to bottom
PIXELS = ("pixel_error_by_height", "pixel_error_3", "pixel_error_2", "pixel_error_1")
MEASURES = ("mse", "twin_difference_explained", "right_twin_chosen", "sequence_stability_accuracy", "probe_accuracy")
COLUMNS = [
    *KEY,
    *("num_test", "training_seconds", "training_cpu_seconds", "parameters", "optimizer", "learning_rate"),
    *("commit", "predictor"),
    *(f"{measure}{end}" for measure in MEASURES for end in ("", "_low", "_high")),
    *SHARE,
    *(f"{measure}{end}" for measure in PIXELS for end in ("", "_low", "_high")),
]


def main(outputs: Path, table: Path) -> None:
    """Read, merge, sort, write."""
    commit = committed()
    found = pd.DataFrame([line_of(path, commit) for path in sorted(outputs.glob(f"*/*/*/*/*/seed*/{METRICS}"))])
    if found.empty:
        sys.exit(f"{outputs}: no finished runs")
    found[SHARE] = np.nan
    predictors = found[(found["positions"] == "ground_truth") & ~found["model"].str.startswith("derenderer")]
    for _, tested in predictors.groupby(TESTED):
        found.loc[tested.index, SHARE] = shares(tested)
    before = [pd.read_csv(table, keep_default_na=False, dtype=str)] if table.exists() else []
    merged = pd.concat([*before, found.reindex(columns=COLUMNS).map(as_text)], ignore_index=True).fillna("")
    merged["commit"] = merged.groupby(SAME_RUN)["commit"].transform("first")
    trained_last = merged.sort_values("predictor", key=lambda given: given == "", kind="stable")
    kept = trained_last.drop_duplicates(KEY, keep="last").sort_values(KEY)[COLUMNS]
    write_atomically(table, kept.to_csv(index=False).encode())
    print(f"{table}: {len(found)} runs of commit {commit}, {len(kept)} in all")


def committed() -> str:
    """The commit that the code of this checkout is of."""
    changed = subprocess.check_output(["git", "status", "--porcelain", "--", "src", "conf"], cwd=ROOT, text=True)
    if changed:
        sys.exit(f"not committed, so nobody could make these results again:\n{changed}")
    return subprocess.check_output(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, text=True).strip()


def line_of(path: Path, commit: str) -> dict[str, object]:
    """A run's line of the table."""
    line = read_line(path)
    measures = {
        f"{measure}{end}": line.get(f"{kind}.{measure}")
        for measure in (*MEASURES, *PIXELS)
        for end, kind in (("", "metrics"), ("_low", "low"), ("_high", "high"))
    }
    return line | measures | {"datasets": " ".join(line["dataset_ids"]), "max_epochs": line["epochs"], "commit": commit}


def shares(tested: pd.DataFrame) -> list[list[float]]:
    """The share of each run with its interval, of the experiments that the oracles were asked about; NaN without both oracles.

    Of oracles with settings of their own there is none.
    """
    plain = tested[tested["variant"].str.replace(DATA_KEYS, "", regex=True) == ""]
    ends = [[stored_scores(run) for run in plain[plain["model"] == model].to_dict("records")] for model in ENDS]
    return [list(share_of_gain([stored_scores(run)], *ends)) for run in tested.to_dict("records")]


def as_text(value: object) -> str:
    """Six decimals, so that rounding to three does not round twice; nothing for a missing value, and no negative zero."""
    if value is None or value != value:
        return ""
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument(
        "outputs", nargs="?", type=Path, default=Path(folder("COPHY_OUTPUTS")), help="where runs are kept"
    )
    parser.add_argument("table", nargs="?", type=Path, default=TABLE, help="the table that they are added to")
    main(**vars(parser.parse_args()))
