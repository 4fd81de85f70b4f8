"""How many people tell the two settings apart, if people were as simulated participants are."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import ttest_1samp

NUM_PEOPLE = (5, 10, 20, 30, 50, 75, 100, 150, 200, 300)
NUM_STUDIES = 2000  # that are drawn for each number of people
SIGNIFICANCE = 0.05
WANTED = 0.8  # the power that is asked of a study by custom


def differences(judged: pd.DataFrame) -> np.ndarray:
    """(participant,) how much smaller a participant's mean error is with AB than without, pixels of 448.

    Args:
        judged: Clicks of one kind of participants, see `judge`.
    """
    answers = judged[judged["practice"] == 0].groupby(["participant", "setting", "experiment"])["error"].mean()
    means = answers.groupby(level=["participant", "setting"]).mean().unstack("setting")
    return (means["non_cf"] - means["cf"]).dropna().to_numpy()


def power_curve(difference: np.ndarray, seed: int) -> pd.DataFrame:
    """Share of studies of n people in which a paired t-test (two-sided, 5 %) finds that AB helps.

    Args:
        difference: See `differences`; people are drawn from these with replacement.
        seed: Of the draws.

    Returns:
        Columns people and power.
    """
    rng, lines = np.random.default_rng(seed), []
    for people in NUM_PEOPLE:
        drawn = difference[rng.integers(len(difference), size=(NUM_STUDIES, people))]
        test = ttest_1samp(drawn, 0.0, axis=1)
        found = (np.asarray(test.pvalue) < SIGNIFICANCE) & (drawn.mean(axis=1) > 0)
        lines.append({"people": people, "power": float(found.mean())})
    return pd.DataFrame(lines)


def people_needed(curve: pd.DataFrame) -> float:
    """Where the curve crosses 80 %, between its points in a straight line; NaN where it never does."""
    above = curve["power"] >= WANTED
    if not above.any():
        return float("nan")
    last = int(np.argmax(above.to_numpy()))
    if last == 0:
        return float(curve["people"].iloc[0])
    part = curve.iloc[last - 1 : last + 1]
    return float(np.interp(WANTED, part["power"], part["people"]))


def draw_power(curve: pd.DataFrame, difference: np.ndarray, title: str) -> Figure:
    """The curve as a figure.

    Args:
        curve: See `power_curve`.
        difference: See `differences`.
        title: Of the figure.
    """
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.plot(curve["people"], curve["power"], marker="o")
    axis.axhline(WANTED, color="0.6", linestyle="--", linewidth=1)
    axis.set(xlabel="people", ylabel="studies that find the difference", ylim=(0, 1.02), xlim=(0, None))
    axis.yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axis.grid(alpha=0.2)
    said = f"AB helps by {difference.mean():.1f} ± {difference.std(ddof=1):.1f} pixels (mean ± SD over participants)"
    axis.set_title(f"{title}\n{said}", fontsize="medium")
    return figure
