"""The answer file: damaged, foreign and locked files are named and left as they are; transactions are whole or nothing."""

import sqlite3
from pathlib import Path

import pytest

from cophy.errors import CophyError
from cophy.study.answers import AnswerStore, exclusive, naming_file, open_answers
from tests.conftest import refused
from tests.study.conftest import Site, take_task


@pytest.fixture
def path(site: Site) -> Path:
    """A closed answer file with an answer."""
    take_task(site.participant())
    site.sessions.store.close()
    return site.path


def refuse(path: Path, message: str) -> None:
    """Check that readers and writers name the file, and that nothing changes it."""
    before = path.read_bytes() if path.is_file() else None
    for use in (AnswerStore, lambda path: open_answers(path).__enter__()):
        with refused(message) as raised:
            use(path)
        assert str(path) in str(raised.value)
    assert (path.read_bytes() if path.is_file() else None) == before


def test_a_damaged_file_is_named_and_not_changed(path: Path) -> None:
    whole = path.read_bytes()
    for content in (whole[:-4096], whole[:4096] + b"x" * 4096 + whole[8192:], b"not a database" * 1000):
        path.write_bytes(content)
        refuse(path, "is damaged or not an answer file")


def test_a_folder_at_the_path_of_the_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "answers.sqlite").mkdir()
    refuse(tmp_path / "answers.sqlite", "not a regular file")


def test_a_database_with_other_tables_is_named_and_not_changed(tmp_path: Path) -> None:
    path = tmp_path / "other.sqlite"
    with sqlite3.connect(path) as db:
        db.execute("CREATE TABLE answers (participant INTEGER)")
    db.close()
    refuse(path, "table answers has other columns")


def test_text_that_is_not_utf_8_is_named(path: Path) -> None:
    with sqlite3.connect(path) as db:
        db.execute("UPDATE participants SET code = CAST(x'ff' AS TEXT)")
    db.close()
    with pytest.raises(CophyError, match="is damaged"), open_answers(path) as db:
        db.execute("SELECT code FROM participants").fetchall()


def test_a_locked_file_is_not_called_damaged(path: Path) -> None:
    with sqlite3.connect(path, isolation_level=None) as other:
        other.execute("PRAGMA locking_mode=EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(CophyError, match="is in use by another program"), naming_file(path):
            sqlite3.connect(path, timeout=0).execute("SELECT * FROM answers")
    other.close()


def test_errors_of_the_program_keep_their_traceback(path: Path) -> None:
    with pytest.raises(sqlite3.OperationalError, match="no such column"), open_answers(path) as db:
        db.execute("SELECT missing_column FROM answers")


def test_only_one_process_writes_to_a_file(tmp_path: Path) -> None:
    path = tmp_path / "answers.sqlite"
    with exclusive(path), pytest.raises(CophyError, match="is being written by another process"), exclusive(path):
        pass


def test_a_transaction_that_fails_writes_nothing_and_does_not_block_the_next_one(site: Site) -> None:
    def write() -> None:
        with site.sessions.store.transaction() as db:
            db.execute("PRAGMA defer_foreign_keys=ON")
            db.execute("INSERT INTO clicks VALUES (1, 2, 3, NULL, NULL, NULL)")  # of no participant: COMMIT fails

    with pytest.raises(sqlite3.IntegrityError):
        write()
    assert site.rows("SELECT count(*) FROM clicks") == [(0,)]
