"""Errors of clicks: read an answer file, compare clicks with where objects end, and compute the human rows of Table 1.

Files are only read, also while the study is running.
"""

import logging
from pathlib import Path

import numpy as np
import pandas as pd

from cophy.atomic_files import write_atomically
from cophy.bootstrap import interval, mean
from cophy.dataset.splits import Split
from cophy.dataset.states import States, sort_by_twins
from cophy.errors import CophyError
from cophy.study.answers import ANSWERS, damaged_error, open_answers
from cophy.study.experiments import Scenes
from cophy.study.plan import MAX_RESOLUTION, SETTINGS, StudySettings

log = logging.getLogger(__name__)

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
STUDIES = """
SELECT study, description, count(*) AS participants FROM participants JOIN studies USING (study) GROUP BY study
"""
REFERENCE_RESOLUTION = 448  # paper Table 1: errors are in pixels of images of 448 × 448
COLUMNS = (
    *("kind", "setting", "measure", "mean", "sigma", "low_people", "high_people", "low_pairs", "high_pairs"),
    *("participants", "answers", "missing"),
)


def read_descriptions(path: Path) -> dict[str, str]:
    """Return the description (JSON) of every study in an answer file, by its id.

    Raises:
        CophyError: See `open_answers`.
    """
    return dict(_query(path, "SELECT study, description FROM studies ORDER BY study").itertuples(index=False))


def read_clicks(path: Path, study: str) -> pd.DataFrame:
    """Return one row per object of every answer of a study; x and y are NaN where it was not clicked.

    Raises:
        CophyError: See `open_answers`.
    """
    clicks = _query(path, CLICKS, study)
    clicks = clicks.assign(x=clicks["x"].astype(float), y=clicks["y"].astype(float))
    for axis in "xy":
        if not (clicks[axis].between(0, MAX_RESOLUTION) | clicks[axis].isna()).all():
            raise damaged_error(path, "a click is outside of every image")
    if not clicks["setting"].isin(SETTINGS).all():
        raise damaged_error(path, f"the setting of an answer is not among {', '.join(SETTINGS)}")
    return clicks


def read_participants(path: Path, study: str) -> pd.DataFrame:
    """Return one row per participant of a study.

    Columns: kind, participant (the number as in clicks), code (completion code), consented_at and finished_at (seconds
    since 1970, finished_at NaN for unfinished participants), answers (without practice).

    Raises:
        CophyError: The file has no participants of this study, or see `open_answers`.
    """
    participants = _query(path, PARTICIPANTS, study)
    if participants.empty:
        studies = _query(path, STUDIES).itertuples()
        others = "; ".join(f"{row.participants} participants of study {row.study} {row.description}" for row in studies)
        content = f"it has {others}: set the keys that it was served with" if others else "it is empty"
        raise CophyError(
            f"{path} has no participants of study {study} (it follows from the data and study.*); {content}"
        )
    return participants


def _query(path: Path, query: str, *parameters: str) -> pd.DataFrame:
    with open_answers(path) as db:
        cursor = db.execute(query, parameters)
        columns = [name for name, *_ in cursor.description]
        return pd.DataFrame.from_records(cursor.fetchall(), columns=columns, coerce_float=True)


def judge(clicks: pd.DataFrame, scenes: Scenes) -> pd.DataFrame:
    """Add to clicks the object's name, color and rank in C (1 is the lowest), its true end, and the error.

    The error is in pixels of an image of 448 × 448, NaN where the object was not clicked.

    Raises:
        CophyError: An answer belongs to an experiment that the dataset does not have, or to an object that is not in C.
    """
    truth = []
    for experiment in clicks["experiment"].unique().tolist():
        if not 0 <= experiment < len(scenes):
            raise CophyError(f"an answer belongs to experiment {experiment}, which the dataset does not have")
        ends = scenes.ends(experiment)
        for rank, item in enumerate(scenes.objects(experiment), start=1):
            truth.append((experiment, item["slot"], item["name"], item["color"], rank, *ends[item["slot"]]))
    columns = ["experiment", "slot", "object", "color", "rank", "true_x", "true_y"]
    judged = clicks.merge(pd.DataFrame(truth, columns=columns), on=["experiment", "slot"], how="left", validate="m:1")
    if judged["rank"].isna().any():
        raise CophyError("an answer has a click on an object that is not in C")
    distance = np.hypot(judged["x"] - judged["true_x"], judged["y"] - judged["true_y"])
    return judged.assign(error=distance * REFERENCE_RESOLUTION / scenes.resolution)


def read_judged(path: Path, states: States, split: Split, settings: StudySettings) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the participants of a study (see `read_participants`) and their clicks with errors (see `judge`).

    Raises:
        CophyError: Nobody took this study, or its dataset does not exist; it is not generated for answers of another study.
    """
    study = settings.study_id(states.spec.scenario.name, states.id, split.name)
    participants, clicks = read_participants(path, study), read_clicks(path, study)
    arrays = sort_by_twins(states.load(), states.spec)
    return participants, judge(clicks, Scenes(states.spec.scenario, arrays, settings.resolution))


def human_rows(judged: pd.DataFrame) -> pd.DataFrame:
    """Compute one row per kind of participants, setting and measure, without practice.

    Measures: rank_1 is the mean error over answers on the lowest object of C, rank_2 that on the next object; mean is the
    mean over the ranks, as in the paper's Table 1. Errors are in pixels of 448 × 448.

    Columns: kind, setting, measure, mean; sigma, the standard deviation over answers (for the measure mean, of an answer's
    mean error over its clicked objects); low_people and high_people, the 95 % bootstrap interval of the mean over
    participants; low_pairs and high_pairs, that over twin pairs; participants; answers; missing, the share of objects that
    were not clicked.
    """
    rows = []
    for (kind, setting), clicks in judged[judged["practice"] == 0].groupby(["kind", "setting"]):
        measures = {f"rank_{rank}": group for rank, group in clicks.groupby("rank")} | {"mean": clicks}
        for measure, group in measures.items():
            by_rank = group.groupby(["participant", "experiment", "rank"])["error"].mean().unstack("rank")
            table = by_rank.dropna(axis=1, how="all")
            if table.empty:
                continue
            errors, answers = table.to_numpy(), table.index.to_frame()
            people = interval(errors, answers["participant"].to_numpy())
            pairs = interval(errors, answers["experiment"].to_numpy() // 2)
            sigma, missing = table.mean(axis=1).std(ddof=0), group["x"].isna().mean()
            counts = answers["participant"].nunique(), len(answers)
            rows.append((kind, setting, measure, mean(errors), sigma, *people, *pairs, *counts, missing))
    return pd.DataFrame(rows, columns=COLUMNS)


def export_answers(states: States, split: Split, settings: StudySettings, directory: Path) -> None:
    """Write answers.csv (one row per object of every answer), participants.csv, and table.csv with the rows of Table 1."""
    path = directory / ANSWERS
    if not path.exists():
        raise CophyError(f"{path} does not exist: nobody has taken this study yet")
    participants, judged = read_judged(path, states, split, settings)
    rows = human_rows(judged)
    for name, table in (("answers.csv", judged), ("participants.csv", participants), ("table.csv", rows)):
        write_atomically(path.with_name(name), table.to_csv(index=False).encode())
    text = "only answers to practice tasks so far" if rows.empty else rows.round(2).to_string()
    files = f"{len(judged)} clicks in answers.csv, {len(participants)} participants and their codes in participants.csv"
    log.info("%s\n%s, these rows in table.csv: %s", text, files, path.parent)
