"""What was run: which rows on which splits, their MSE, how long they were trained, and with how many seeds.

What runs made of AB, without any oracle: do their predictions tell twins apart?
"""

from collections.abc import Iterator

import pandas as pd

from cophy.report.figures import in_order, row_name
from cophy.report.runs import POSITIONS, of_seeds

MEASURES = {
    "twin_difference_explained": "Of the twins' difference, explained",
    "right_twin_chosen": "Right twin chosen",
}
BESIDE = ["scenario", "split", "size", "positions"]  # what runs of one column share, but for their epochs
CAPTION = (
    "Twins share A, C and the do-operation and differ in their confounders, which AB alone shows. Explained: "
    "1 - Σ|ΔP - ΔD|² ÷ Σ|ΔD|², with ΔP and ΔD the predicted and the true difference between twins; 0 % for any model "
    "without AB, 100 % for a perfect one. Right twin: how often P is nearer to its own D than to the twin's; 50 % by "
    "chance. [ ]: 95 % bootstrap interval over twin pairs; ±: standard deviation over seeds."
)


def twin_tables(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Title to a table of rows × tested splits, for all runs that were tested on twins.

    Args:
        runs: See `read_runs`.

    Returns:
        Empty where no run was tested on twins.
    """
    if not set(MEASURES) <= set(runs.columns) or runs["right_twin_chosen"].isna().all():
        return {}
    tested = _beside_longest(runs[runs["right_twin_chosen"].notna()])
    row = [row_name(model, ablation) for model, ablation in zip(tested["model"], tested["ablation"], strict=True)]
    named = tested.assign(row=row, column=tested.apply(_column, axis=1))
    return {title: _twin_cells(named, measure) for measure, title in MEASURES.items()}


def _beside_longest(tested: pd.DataFrame) -> pd.DataFrame:
    """The runs; those that trained nothing, as copies, take the epochs of the longest training beside them, or none."""
    trained = tested["epochs"].where(tested["is_trained"].astype(bool))
    longest = trained.groupby([tested[name] for name in BESIDE]).transform("max")
    return tested.assign(epochs=trained.fillna(longest))


def _column(run: "pd.Series[str]") -> str:
    positions = "" if run["positions"] == "ground_truth" else f", {run['positions']}"
    epochs = "" if pd.isna(run["epochs"]) else f", {run['epochs']:.0f} epochs"
    return f"{run['scenario']} {run['split']}, {run['size']}{epochs}{positions}"


def _twin_cells(runs: pd.DataFrame, measure: str) -> pd.DataFrame:
    texts = {keys: _twin_text(of_seeds(found), measure) for keys, found in runs.groupby(["row", "column"])}
    wide = pd.Series(texts).unstack().fillna(MISSING)
    return wide.loc[in_order(wide.index)]


def _twin_text(found: pd.DataFrame, measure: str) -> str:
    ends = (measure, f"{measure}_low", f"{measure}_high")
    value, low, high = (round(100 * found[name].mean(), 1) + 0.0 for name in ends)  # no "-0.0"
    spread = f" ± {100 * found[measure].std():.1f}" if len(found) > 1 else ""
    return f"{value:.1f} %{spread} [{low:.1f}, {high:.1f}]"


MISSING = "—"


def overviews(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Title to a table of rows × splits. A cell holds MSE, epochs (where anything was trained) and number of seeds.

    Of trainings of several lengths, MSE and seeds are those of the longest.

    Args:
        runs: See `read_runs`.
    """
    return {title: _table(found) for title, found in kinds(runs)}


def kinds(runs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Runs of one scenario, size and kind of positions together, with a title for them."""
    if len(runs):
        for (scenario, size, positions), found in runs.groupby(["scenario", "size", "positions"]):
            yield f"{scenario}, size {size}, {POSITIONS[str(positions)]}", found


def _table(runs: pd.DataFrame) -> pd.DataFrame:
    row = [row_name(model, ablation) for model, ablation in zip(runs["model"], runs["ablation"], strict=True)]
    texts = {keys: _text(found) for keys, found in runs.assign(row=row).groupby(["row", "split"])}
    wide = pd.Series(texts).unstack().fillna(MISSING)
    wide.columns.name = None
    return wide.loc[in_order(wide.index)]


def _text(runs: pd.DataFrame) -> str:
    finished = runs[runs["error"].isna()]
    failed = f"{len(runs) - len(finished)} failed"
    if finished.empty:
        return failed
    lengths = sorted(finished.loc[finished["is_trained"].astype(bool), "epochs"].astype(int).unique())
    epochs = ", ".join(map(str, lengths))
    compared = of_seeds(finished)
    text = f"{compared['mse'].mean():.3f} ({epochs} × {len(compared)})".replace("( ", "(")
    return text if len(finished) == len(runs) else f"{text}, {failed}"
