"""Which runs of a row may be averaged: those that differ in their seed alone."""

import pandas as pd


def of_seeds(runs: pd.DataFrame) -> pd.DataFrame:
    """Of finished runs of one row and size, those of the longest training and of the de-renderer that most of them saw.

    Args:
        runs: See `read_runs`; `epochs` may be NaN where nothing was trained.
    """
    longest = runs if runs["epochs"].isna().all() else runs[runs["epochs"] == runs["epochs"].max()]
    if "derenderer" not in longest or longest["derenderer"].nunique() < 2:
        return longest
    return longest[longest["derenderer"] == longest["derenderer"].mode().iloc[0]]


def of_largest_size(runs: pd.DataFrame) -> pd.DataFrame:
    """Of finished runs, those of the size with most training experiments; others saw other data."""
    return runs[runs["size"] == runs.sort_values("num_train")["size"].iloc[-1]]
