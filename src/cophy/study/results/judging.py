"""How far clicks are from where objects end, per answer and in the rows of Table 1."""

import numpy as np
import pandas as pd

from cophy.bootstrap import interval, mean
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
    missing. The measure rank_1 is the error on the lowest object of C, rank_2 on the next: the mean over answers. The measure
    mean is the mean of these, as in the paper's Table 1. Sigma is the standard deviation over answers; for the measure mean,
    of an answer's mean error over its clicked objects. All are in pixels. The 95 % intervals of the mean draw participants
    anew, or twin pairs. missing is the share of objects that were not clicked.
    """
    lines = []
    for (kind, setting), found in judged[judged["practice"] == 0].groupby(["kind", "setting"]):
        measures = {f"rank_{rank}": objects for rank, objects in found.groupby("rank")} | {"mean": found}
        for measure, objects in measures.items():
            by_rank = objects.groupby(["participant", "experiment", "rank"])["error"].mean().unstack("rank")
            errors = by_rank.dropna(axis=1, how="all")
            if errors.empty:
                continue
            answers = errors.index.to_frame()
            low_people, high_people = interval(errors.to_numpy(), answers["participant"].to_numpy())
            low_pairs, high_pairs = interval(errors.to_numpy(), answers["experiment"].to_numpy() // 2)
            lines.append(
                {
                    **{"kind": kind, "setting": setting, "measure": measure},
                    **{"mean": mean(errors.to_numpy()), "sigma": errors.mean(axis=1).std(ddof=0)},
                    **{"low_people": low_people, "high_people": high_people},
                    **{"low_pairs": low_pairs, "high_pairs": high_pairs},
                    **{"participants": answers["participant"].nunique(), "answers": len(answers)},
                    "missing": objects["x"].isna().mean(),
                }
            )
    return pd.DataFrame(lines, columns=COLUMNS)
