"""Results that stay when outputs/ go: python benchmarks/results/keep_results.py [outputs [table.csv]]

Adds every finished run to docs/results/results.csv, with the commit of this checkout, and with its share of the possible gain where
both oracles of its test data are known: from oracles.csv next to the table, to which the errors of oracles among the runs are
added. A run that is in the table already (the same names, data and epochs) is replaced, but no training
by a test of given weights (predictor=), whose commit is that of the test. One that was not made again keeps its commit. Run it
before the code changes: no file of src/ or conf/ may differ from the commit.
"""

import subprocess
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import pandas as pd

from cophy.atomic_files import write_atomically
from cophy.config import folder
from cophy.report.paper_tables import TRUE_POSITIONS
from cophy.report.predictions import stored_scores
from cophy.report.runs import read_line
from cophy.report.tables import share_of_gain
from cophy.scoring import Scores
from cophy.training.run import METRICS

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "docs" / "results" / "results.csv"
ERRORS = "oracles.csv"  # of each oracle on each experiment
NAMES = ["scenario", "split", "model", "ablation", "positions", "size", "variant", "seed"]
KEY = [*NAMES, "datasets", "num_train", "max_epochs"]
SAME_RUN = [*KEY, "predictor", "training_seconds", "mse"]  # the seconds of two trainings differ
ENDS = ("oracle_feedforward", "oracle_counterfactual")  # without AB, with AB
DATA_KEYS = r"\+(size|data_seed|max_experiments)-\w+"  # parts of a variant that only say which experiments a run is on
TESTED = ["scenario", "test_dataset"]  # what a run and the oracles that it is compared with have in common
ENDS_KEY = [*TESTED, "model"]
PER_EXPERIMENT = ["experiment", "cluster", "truth", "mse"]  # see `Scores`
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
    runs = pd.DataFrame([line_of(path, commit) for path in sorted(outputs.glob(f"*/*/*/*/*/seed*/{METRICS}"))])
    if runs.empty:
        sys.exit(f"{outputs}: no finished runs")
    predictors = runs[(runs["positions"] == TRUE_POSITIONS) & (runs["model"] != "derenderer")]
    ends = errors_of_oracles(predictors, table.with_name(ERRORS))
    runs = runs.join(pd.DataFrame(shares(predictors, ends), predictors.index, SHARE))
    before = [pd.read_csv(table, keep_default_na=False, dtype=str)] if table.exists() else []
    merged = pd.concat([*before, runs.reindex(columns=COLUMNS).map(as_text)], ignore_index=True).fillna("")
    merged["commit"] = merged.groupby(SAME_RUN)["commit"].transform("first")
    trained_last = merged.sort_values("predictor", key=lambda predictor: predictor == "", kind="stable")
    rows = trained_last.drop_duplicates(KEY, keep="last").sort_values(KEY)[COLUMNS]
    write_atomically(table, rows.to_csv(index=False).encode())
    print(f"{table}: {len(runs)} runs of commit {commit}, {len(rows)} in all")


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
    ids = line["dataset_ids"]
    columns = {"datasets": " ".join(ids), "test_dataset": ids[-1], "max_epochs": line["epochs"], "commit": commit}
    return line | measures | columns


def errors_of_oracles(predictors: pd.DataFrame, file: Path) -> pd.DataFrame:
    """Add the errors of both oracles, wherever they are among the runs, to a file; return all in it.

    Oracles with settings of their own are left out.
    """
    plain = predictors["variant"].str.replace(DATA_KEYS, "", regex=True) == ""
    parts = [pd.read_csv(file, dtype={"truth": str}).astype({"truth": float})] if file.exists() else []  # all digits
    for run in predictors[plain & predictors["model"].isin(ENDS)].to_dict("records"):
        scores = stored_scores(run)
        errors = pd.DataFrame({name: getattr(scores, name) for name in PER_EXPERIMENT}).astype({"truth": float})
        parts.append(errors.assign(**{name: run[name] for name in ENDS_KEY}))
    if not parts:
        return pd.DataFrame(columns=[*ENDS_KEY, *PER_EXPERIMENT])
    names = [*ENDS_KEY, "experiment"]
    errors = pd.concat(parts, ignore_index=True).drop_duplicates(names, keep="last").sort_values(names)
    write_atomically(file, errors[[*ENDS_KEY, *PER_EXPERIMENT]].to_csv(index=False).encode())
    return errors


def shares(predictors: pd.DataFrame, errors: pd.DataFrame) -> list[list[float]]:
    """The share of each run with its interval, of the experiments that the oracles were asked about; NaN without both oracles."""
    oracles = {}
    for key, part in errors.groupby(ENDS_KEY):
        experiment, cluster, truth, mse = (part[name].to_numpy() for name in PER_EXPERIMENT)
        oracles[key] = Scores(experiment, cluster, truth, {"mse": mse})
    rows = []
    for run in predictors.to_dict("records"):
        keys = [(*(run[name] for name in TESTED), model) for model in ENDS]
        ends = [[oracles[key]] if key in oracles else [] for key in keys]
        rows.append(list(share_of_gain([stored_scores(run)], *ends)))
    return rows


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
