"""How far clicks are from where objects end, per answer and in the rows of Table 1.

Reads a file of answers, while the study may be going on. Nothing is written to it.
"""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd

from cophy.bootstrap import interval, mean
from cophy.errors import CophyError
from cophy.study.answers import check, damaged, naming
from cophy.study.experiments import Scenes
from cophy.study.settings import MAX_RESOLUTION, SETTINGS

CLICKS = """
SELECT p.kind, p.number AS participant, a.position, a.practice, a.setting, a.experiment, c.slot, c.x, c.y, c.at_ms,
    a.late, a.undone, a.names_shown, a.input, a.window_width, a.window_height, a.opened_at, a.begun_at, a.answered_at
FROM participants p JOIN answers a ON a.participant = p.id JOIN clicks c USING (participant, position)
WHERE p.study = ? ORDER BY p.kind, p.number, a.position, c.slot
"""
PARTICIPANTS = """
SELECT p.kind, p.number AS participant, p.code, p.consented_at, p.finished_at, count(a.answered_at) AS answers
FROM participants p LEFT JOIN answers a ON a.participant = p.id AND a.practice = 0
WHERE p.study = ? GROUP BY p.id ORDER BY p.kind, p.number
"""
STUDIES = "SELECT study, description, count(*) AS people FROM participants JOIN studies USING (study) GROUP BY study"
DESCRIPTIONS = "SELECT study, description FROM studies ORDER BY study"


def read_descriptions(path: Path) -> dict[str, str]:
    """What each study of a file is, by its name: JSON.

    Raises:
        CophyError: It is no file of answers, or damaged.
    """
    return dict(_read(path, DESCRIPTIONS).itertuples(index=False))


def read_clicks(path: Path, study: str) -> pd.DataFrame:
    """One line per object of every answer of a study, x and y NaN where it was not clicked.

    Raises:
        CophyError: It is no file of answers, or damaged.
    """
    clicks = _read(path, CLICKS, study)
    clicks = clicks.assign(x=clicks["x"].astype(float), y=clicks["y"].astype(float))
    for axis in "xy":
        if not (clicks[axis].between(0, MAX_RESOLUTION) | clicks[axis].isna()).all():
            raise damaged(path, "a click is beside every picture")
    if not clicks["setting"].isin(SETTINGS).all():
        raise damaged(path, f"an answer's setting is none of {', '.join(SETTINGS)}")
    return clicks


def read_participants(path: Path, study: str) -> pd.DataFrame:
    """One line per participant of a study.

    Columns: kind, participant (the number that clicks have), code (completion code), consented_at and finished_at (seconds
    since 1970; finished_at is NaN for who is not done), answers (without practice).

    Raises:
        CophyError: There are none; names the studies that there are. Or it is no file of answers, or damaged.
    """
    found = _read(path, PARTICIPANTS, study)
    if found.empty:
        others = [
            f"{each.people} participants of study {each.study} {each.description}"
            for each in _read(path, STUDIES).itertuples()
        ]
        held = f"it holds {'; '.join(others)}: give the keys that it was served with" if others else "it is empty"
        raise CophyError(f"{path} has nobody of study {study}, which follows from the data and from study.*; {held}")
    return found


def _read(path: Path, query: str, *parameters: str) -> pd.DataFrame:
    with naming(path), closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        check(connection, path)
        found = connection.execute(query, parameters)
        names = [name for name, *_ in found.description]
        return pd.DataFrame.from_records(found.fetchall(), columns=names, coerce_float=True)


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
