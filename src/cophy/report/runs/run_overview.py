"""What was run: which rows on which splits, their MSE, how long they were trained, and with how many seeds."""

from collections.abc import Iterator

import pandas as pd

from cophy.report.figures import in_order, row_name
from cophy.report.runs.comparable import of_seeds
from cophy.report.runs.stored_run import POSITIONS

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
