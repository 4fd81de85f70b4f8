"""The rows of people in Table 1, and tables of what was answered in every study."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from cophy.report.people.study_answers import StudyAnswers
from cophy.study.answer_store import PERSON

SETTINGS = {"non_cf": "without AB", "cf": "with AB"}
CAPTION = (
    "Error of the clicks, pixels of 448 × 448: mean over answers. 1 is the lowest object of C; the mean is of these columns. "
    "σ: standard deviation over answers, of their mean error over clicked objects. By people, by pairs: 95 % interval of the mean, "
    "people or twin pairs drawn anew. The models of Table 1 are tested on all pairs."
)


def of_people(studies: Sequence[StudyAnswers], scenario: str, split: str) -> pd.DataFrame:
    """What fills the rows of people in Table 1: one line per setting and metric.

    Args:
        studies: All that were found.
        scenario: Of the table.
        split: Of the table.

    Returns:
        Columns people (the setting), metric, ours, sd, low and high (by participant). Where there are several studies, those
        of the one with the most answers.
    """
    rows = [s.rows[s.rows["kind"] == PERSON] for s in studies if (s.scenario, s.split) == (scenario, split)]
    largest = max(rows, key=lambda found: int(found["answers"].sum()), default=pd.DataFrame())
    if largest.empty:
        return pd.DataFrame(columns=["people", "metric", "ours", "sd", "low", "high"])
    metric = largest["measure"].str.replace("rank", "pixel_error").replace("mean", "pixel_error_by_height")
    found = largest.assign(people=largest["setting"], metric=metric, ours=largest["mean"], sd=largest["sigma"])
    return found.assign(low=found["low_people"], high=found["high_people"])[
        ["people", "metric", "ours", "sd", "low", "high", "participants", "answers"]
    ]


def study_tables(studies: Sequence[StudyAnswers]) -> dict[str, pd.DataFrame]:
    """Title -> what people answered, and, apart, what simulated participants did."""
    tables: dict[str, pd.DataFrame] = {}
    for study in studies:
        for are_people in (True, False):
            rows = study.rows[(study.rows["kind"] == PERSON) == are_people]
            if len(rows):
                who = "people" if are_people else "simulated participants, no people"
                title = f"Human study, {study.scenario} {study.split}: {who}"
                while title in tables:  # a study with other settings
                    title += " (another study)"
                tables[title] = _table(rows)
    return tables


def _table(rows: pd.DataFrame) -> pd.DataFrame:
    lines = {}
    for (kind, setting), found in rows.groupby(["kind", "setting"], sort=False):
        by_measure = found.set_index("measure")
        mean = by_measure.loc["mean"]
        ranks = sorted(name for name in by_measure.index if name != "mean")
        label = SETTINGS[str(setting)] if kind == PERSON else f"{kind}, {SETTINGS[str(setting)]}"
        lines[label] = {
            **{rank.removeprefix("rank_"): f"{by_measure['mean'][rank]:.1f}" for rank in ranks},
            "mean": f"{mean['mean']:.1f}",
            "σ": f"{mean['sigma']:.1f}",
            "by people": f"[{mean['low_people']:.1f}, {mean['high_people']:.1f}]",
            "by pairs": f"[{mean['low_pairs']:.1f}, {mean['high_pairs']:.1f}]",
            "participants": str(mean["participants"]),
            "answers": str(mean["answers"]),
            "not clicked": f"{np.round(100 * mean['missing'], 1)} %",
        }
    return pd.DataFrame(lines).T
