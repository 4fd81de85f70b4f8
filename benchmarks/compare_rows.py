"""Is one model better than another? python benchmarks/compare_rows.py alongside cophynet [outputs]

What a run changes beyond its model is named as its directory has it: cophynet+max_epochs-55. Both were tested on the same
experiments, so their errors are compared experiment by experiment. Prints a Markdown table with a line per tested split: the seeds
that both have, both MSE (mean over seeds), and their difference with its 95 % interval.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from cophy.app.report_choices import ComposedChoices
from cophy.app.schemas.registration import register
from cophy.bootstrap import interval, mean
from cophy.report.runs.run_table import read_runs
from cophy.report.tables.shares import stored_errors

TESTED = ["scenario", "split", "positions", "size"]  # what both runs share


def main(ours: str, other: str, outputs: Path) -> None:
    """Compare two models, both with ablation=full, wherever both were run."""
    register()
    runs = read_runs(outputs, ComposedChoices("generated", Path("data")).keys_of)
    finished = runs[runs["error"].isna() & (runs["ablation"] == "full")]
    name = finished["model"] + finished["variant"].str.replace(r"\+size-\w+", "", regex=True)
    if unknown := {ours, other} - set(name):
        sys.exit(f"{outputs}: no run of {', '.join(sorted(unknown))}; there are {', '.join(sorted(set(name)))}")
    lines = [
        dict(zip(TESTED, tested, strict=True)) | line
        for tested, found in finished.groupby(TESTED)
        if (line := compared(*(found[name[found.index] == each] for each in (ours, other))))
    ]
    print(pd.DataFrame(lines).to_markdown(index=False, floatfmt=".3f"))


def compared(ours: pd.DataFrame, other: pd.DataFrame) -> dict[str, object]:
    """The difference of two rows of a table; nothing where no seed was run with both."""
    seeds = sorted(set(ours["seed"]) & set(other["seed"]))
    errors = [
        [stored_errors(run) for run in rows[rows["seed"].isin(seeds)].to_dict("records")] for rows in (ours, other)
    ]
    if not seeds or len({each.pair.tobytes() for part in errors for each in part}) > 1:
        return {}
    one, two = (np.mean([each.mse for each in part], axis=0) for part in errors)
    low, high = interval(one - two, errors[0][0].pair)
    return {
        "epochs": ", ".join(sorted({str(epochs) for rows in (ours, other) for epochs in rows["epochs"]}, key=int)),
        "seeds": ", ".join(map(str, seeds)),
        "MSE": mean(one),
        "other's": mean(two),
        "difference": f"{mean(one - two):.3f} [{low:.3f}, {high:.3f}]",
    }


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(str(__doc__))
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3] if len(sys.argv) == 4 else "outputs"))
