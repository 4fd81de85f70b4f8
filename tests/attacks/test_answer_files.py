"""A file of answers that is wrong in any way is named or does no harm: to who exports, reports or serves it."""

import logging
import shutil
import sqlite3
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import note
from hypothesis import strategies as st

from cophy.commands.report import ComposedData
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.study.answers import AnswerStore
from cophy.study.judging import read_clicks, read_participants
from cophy.study.report import draw_studies, read_answers, study_tables
from tests.attacks.faults import FAULTS
from tests.attacks.often import often
from tests.conftest import tiny_spec
from tests.study.test_participants_in_report import description, write_answers

HUGE = 2**30
USES: tuple[Callable[[Path], object], ...] = (
    lambda path: read_participants(path, "s"),
    lambda path: read_clicks(path, "s"),
    lambda path: AnswerStore(path).close(),
)


@pytest.fixture
def whole(tiny_data: Path, tmp_path: Path) -> Path:
    """Two files of answers, each in a folder of its own."""
    for name in ("x", "y"):
        path = tmp_path / "whole" / "study" / name / "answers.sqlite"
        write_answers(path, description(States(tiny_spec("blocktower"), tiny_data).id))
        with sqlite3.connect(path) as db:
            db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        db.close()
    return tmp_path / "whole"


def content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() and path.stat().st_size < HUGE else None


def attack(whole: Path, world: Path, choices: ComposedData, caplog: pytest.LogCaptureFixture, draw: Any) -> None:
    shutil.rmtree(world, ignore_errors=True)
    shutil.copytree(whole, world)
    path = world / "study" / "x" / "answers.sqlite"
    fault = draw(st.sampled_from(FAULTS))
    fault(path, draw)
    before = content(path)
    note(fault.__name__)
    caplog.clear()
    with warnings.catch_warnings(), caplog.at_level(logging.INFO):
        warnings.simplefilter("ignore")  # of numbers that are wrong, but numbers
        found = read_answers(world, choices.dataset)
        study_tables(found)
        list(draw_studies(found))
    said = " ".join(caplog.text.split())
    for use in USES if path.exists() else ():
        try:
            use(path)
        except CophyError as error:
            wrong = str(error)
            assert str(path) in wrong
            assert "\n" not in wrong
            assert content(path) == before
    assert len(found) + said.count("left out") >= 1
    assert not list(world.rglob("executed"))


@pytest.fixture
def choices(tiny_data: Path) -> ComposedData:
    """That compose once what is asked again and again."""
    found = ComposedData("generated", tiny_data)
    found.dataset = cache(found.dataset)  # type: ignore[method-assign]
    return found


def test_a_wrong_file_of_answers_is_named_or_does_no_harm(
    whole: Path, choices: ComposedData, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    often(30, lambda draw: attack(whole, tmp_path / "world", choices, caplog, draw))


@pytest.mark.slow
def test_many_wrong_files_of_answers_are_named_or_do_no_harm(
    whole: Path, choices: ComposedData, tmp_path: Path, caplog: pytest.LogCaptureFixture, attacks: int
) -> None:
    often(40 * attacks, lambda draw: attack(whole, tmp_path / "world", choices, caplog, draw))
