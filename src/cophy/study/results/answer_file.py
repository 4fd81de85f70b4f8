"""Reads a file of answers, while the study may be going on. Nothing is written to it."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pandas as pd

from cophy.errors import CophyError
from cophy.study.answer_tables import check, damaged, naming
from cophy.study.study_settings import MAX_RESOLUTION, SETTINGS

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
