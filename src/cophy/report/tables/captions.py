"""What a filled table says of its cells, and of the runs that they are of."""

import pandas as pd

from cophy.report.tables.paper_tables import PaperTable

TESTED_ON = {  # positions= -> what a caption says of it
    "ground_truth": "Tested on true positions.",
    "derendered": "Trained and tested on positions estimated from pictures.",
    "train_ground_truth_test_derendered": "Tested on positions estimated from pictures.",
}

ORACLES = (
    "Oracles simulate (docs/benchmark/oracles.md). They know what A and C show at t = 0 beyond positions: object type and pose. "
    "A network gets these with model.object_type=true and model.pose=true alone. "
    "What the oracles' draws add to squared errors is estimated and taken out."
)


def caption(table: PaperTable, used: pd.DataFrame) -> str:
    """The caption of a table.

    Args:
        table: Of the paper.
        used: The runs that fill it, see `read_runs`.
    """
    better = "Lower" if table.lower_is_better else "Higher"
    notes = [f"Each cell: ours / the paper's. {better} is better."]
    if used.empty:
        return " ".join([*notes, "Nothing was run yet."])
    num_train, num_test, seeds = (_listed(used[name]) for name in ("num_train", "num_test", "seed"))
    trained = used[used["is_trained"].astype(bool)]  # copies and oracles have epochs, too, that nobody went through
    epochs = "" if trained.empty else f" {_listed(trained['epochs'])} epochs;"
    size = ", ".join(sorted(used["size"].unique()))
    notes.append(" ".join(TESTED_ON[positions] for positions in sorted(used["positions"].unique())))
    notes.append(f"Size {size}: {num_train} training and {num_test} test experiments;{epochs} seeds {seeds}.")
    notes.append(
        "[ ]: 95 % bootstrap interval over the twin pairs of the test split; ±: standard deviation over seeds."
    )
    if "gt_confounders" in used["ablation"].to_numpy():
        notes.append(
            "Where the true confounders are given, they include what positions hide: initial velocity, shape and orientation."
        )
    if table.oracles and used["model"].str.startswith("oracle_").any():
        notes.append(ORACLES)
    if "derenderer" in used and len(names := sorted(used["derenderer"].dropna().unique())):
        notes.append(f"Positions estimated by de-renderer {' and '.join(names)} (hash of its checkpoint).")
    if "predictor" in used and len(before := used[used["predictor"].notna()]):
        named = sorted({f"{run.model} seed {run.seed} ({run.predictor})" for run in before.itertuples()})
        notes.append(f"Not trained here but given as checkpoints (by hash): {', '.join(named)}.")
    return " ".join([*notes, table.note]).strip()


def _listed(counts: "pd.Series[float]") -> str:
    """Each once; they are floats where some run failed and has none."""
    return ", ".join(map(str, sorted(counts.astype(int).unique())))
