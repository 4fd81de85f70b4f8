"""How far clicks are from where objects end, per answer and in the rows of Table 1."""

import numpy as np
import pandas as pd

from cophy.bootstrap import interval
from cophy.errors import CophyError
from cophy.study.scenes import Scenes

COLUMNS = (
    *("kind", "setting", "measure", "mean", "sigma", "low_people", "high_people", "low_pairs", "high_pairs"),
    *("participants", "answers", "missing"),
)
REFERENCE_RESOLUTION = 448  # paper Table 1: pixel errors are given at 448 x 448


def judge(clicks: pd.DataFrame, scenes: Scenes) -> pd.DataFrame:
    """The same with the object's name, its rank from below in C (1 is the lowest), where it ends, and the error.

    The error is in pixels of a picture of 448 × 448, NaN where it was not clicked.

    Raises:
        CophyError: An answer is on an experiment that the data do not have.
    """
    truth = []
    for experiment in clicks["experiment"].unique().tolist():
        if not 0 <= experiment < len(scenes):
            raise CophyError(f"an answer is on experiment {experiment}, which the data do not have")
        ends = scenes.ends(experiment)
        for rank, each in enumerate(scenes.objects(experiment), start=1):
            truth.append((experiment, each["slot"], each["name"], each["color"], rank, *ends[each["slot"]]))
    columns = ["experiment", "slot", "object", "color", "rank", "true_x", "true_y"]
    judged = clicks.merge(pd.DataFrame(truth, columns=columns), on=["experiment", "slot"], how="left", validate="m:1")
    distance = np.hypot(judged["x"] - judged["true_x"], judged["y"] - judged["true_y"])
    return judged.assign(error=distance * REFERENCE_RESOLUTION / scenes.resolution)


def human_rows(judged: pd.DataFrame) -> pd.DataFrame:
    """One line per kind of participant, setting and measure; practice does not count.

    Columns: kind, setting, measure, mean, sigma, low_people, high_people, low_pairs, high_pairs, participants, answers,
    missing. The measure rank_1 is the error on the lowest object of C, rank_2 on the next. The measure mean is the mean error
    of an answer over the objects that were clicked. Mean and sigma (standard deviation) are over answers, in pixels. The
    95 % intervals of the mean draw participants anew, or twin pairs. missing is the share of objects that were not clicked.
    """
    lines = []
    for (kind, setting), found in judged[judged["practice"] == 0].groupby(["kind", "setting"]):
        measures = {f"rank_{rank}": objects for rank, objects in found.groupby("rank")} | {"mean": found}
        for measure, objects in measures.items():
            answers = objects.groupby(["participant", "experiment"], as_index=False)["error"].mean()
            error = answers["error"].to_numpy(float)
            if not np.isfinite(error).any():
                continue
            low_people, high_people = interval(error, answers["participant"].to_numpy())
            low_pairs, high_pairs = interval(error, answers["experiment"].to_numpy() // 2)
            lines.append(
                {
                    **{"kind": kind, "setting": setting, "measure": measure},
                    **{"mean": np.nanmean(error), "sigma": np.nanstd(error)},
                    **{"low_people": low_people, "high_people": high_people},
                    **{"low_pairs": low_pairs, "high_pairs": high_pairs},
                    **{"participants": answers["participant"].nunique(), "answers": len(answers)},
                    "missing": objects["x"].isna().mean(),
                }
            )
    return pd.DataFrame(lines, columns=COLUMNS)
