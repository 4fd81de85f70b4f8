"""Checks of participants' answers, and the SQLite file that stores them.

The file is in WAL mode; an answer is on disk before the page continues. Times are seconds since 1970 (UTC), measured by the
server. Its tables:

- studies. study: name of a study, which follows from the data and from `study.*`. description: scenario, split, dataset,
  resolution and seconds, as JSON.
- participants. kind: `person`, or the kind of a simulated participant; they are never counted together. number: in the plan,
  from 0. token_hash: SHA-256 of the session's token. platform_hash: HMAC-SHA-256 of the platform's id, or NULL; anyone who has
  this file and a list of ids can tell which of them took part. code: completion code. consented_at, finished_at.
- answers. position: of the task, from 0; practice comes first. practice: 1 for practice, which no table counts. experiment: index
  in the dataset. setting: `non_cf` or `cf`. opened_at, begun_at, answered_at: when the task was first sent, its clock began, its
  answer arrived. late: 1 if no answer arrived within `study.seconds` + `study.tolerance_s`. undone: clicks taken back.
  names_shown: whether names were shown on the objects. input: mouse, touch, pen or keyboard. window_width, window_height: CSS
  pixels. digest: of the answer, so that the same answer may be sent twice.
- clicks. slot: of the object. x, y: pixels of the image. at_ms: milliseconds after the clock began; NULL if not clicked.

To delete a participant's answers: `SELECT id FROM participants WHERE code = '...'`; delete from `clicks` and `answers` where
`participant` is this id, then from `participants`. The next new participant takes the free place in the plan.
"""

import os
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from cophy.atomic_files import check_space
from cophy.errors import CophyError
from cophy.locks import locked

ANSWERS, SIMULATED = "answers.sqlite", "simulated.sqlite"  # files of human and of simulated participants
PERSON = "person"  # kind of all participants who are not simulated
INPUT_DEVICES = ("mouse", "touch", "keyboard", "pen", "none")
MAX_UNDONE = 1000
MAX_WINDOW_PX = 20_000


class RefusedError(Exception):
    """A request that is not allowed; `status` is the HTTP status of the response."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


def check_answer(body: Any, *, slots: set[int], resolution: int, last_ms: int) -> None:
    """Check that what a browser sent is an answer to a task.

    An answer has the fields clicks, undone (number of clicks that were undone), names_shown (whether the participant let the
    names be written on the objects), input (device of the last click, one of INPUT_DEVICES), and window (width and height of
    the browser's window, CSS pixels). A click has the slot of its object, x and y (pixels of the image), and at_ms
    (milliseconds after the clock began). Objects that were not clicked have no click.

    Args:
        body: Decoded JSON.
        slots: Slots of the objects in C.
        resolution: Width and height of the image, pixels; clicks have to be inside.
        last_ms: Latest time of a click.

    Raises:
        RefusedError: It is not an answer.
    """
    _require(_has_fields(body, "clicks", "undone", "names_shown", "input", "window"), "not the fields of an answer")
    clicks, window = body["clicks"], body["window"]
    _require(isinstance(clicks, list) and len(clicks) <= len(slots), "clicks: at most one per object")
    for click in clicks:
        _require(_has_fields(click, "slot", "x", "y", "at_ms"), "not the fields of a click")
        is_slot = _is_number(click["slot"], 0, max(slots), int) and click["slot"] in slots
        _require(is_slot, "slot: there is no such object in this image")
        _require(all(_is_number(click[axis], 0, resolution) for axis in "xy"), "x or y: outside of the image")
        _require(_is_number(click["at_ms"], 0, last_ms, int), "at_ms: not within the time of the task")
    _require(len({click["slot"] for click in clicks}) == len(clicks), "clicks: two for one object")
    _require(isinstance(body["names_shown"], bool) and body["input"] in INPUT_DEVICES, "names_shown or input")
    is_pair = isinstance(window, list) and len(window) == 2
    _require(is_pair and all(_is_number(side, 1, MAX_WINDOW_PX, int) for side in window), "window: width and height")
    _require(_is_number(body["undone"], 0, MAX_UNDONE, int), "undone: not a number of clicks")


def _require(condition: bool, reason: str) -> None:
    if not condition:
        raise RefusedError(422, f"This is not an answer: {reason}.")


def _has_fields(body: Any, *names: str) -> bool:
    return isinstance(body, dict) and set(body) == set(names)


def _is_number(value: Any, low: int, high: int, kinds: Any = (int, float)) -> bool:
    return isinstance(value, kinds) and not isinstance(value, bool) and low <= value <= high  # NaN is not between


SCHEMA = """
CREATE TABLE studies (
    study TEXT PRIMARY KEY, description TEXT NOT NULL
) STRICT;
CREATE TABLE participants (
    id INTEGER PRIMARY KEY, study TEXT NOT NULL REFERENCES studies, kind TEXT NOT NULL, number INTEGER NOT NULL,
    token_hash TEXT NOT NULL UNIQUE, platform_hash TEXT, code TEXT NOT NULL UNIQUE,
    consented_at REAL NOT NULL, finished_at REAL,
    UNIQUE (study, kind, number), UNIQUE (study, kind, platform_hash)
) STRICT;
CREATE TABLE answers (
    participant INTEGER NOT NULL REFERENCES participants, position INTEGER NOT NULL, practice INTEGER NOT NULL,
    experiment INTEGER NOT NULL, setting TEXT NOT NULL, opened_at REAL NOT NULL, begun_at REAL, answered_at REAL,
    late INTEGER NOT NULL DEFAULT 0, undone INTEGER, names_shown INTEGER, input TEXT,
    window_width INTEGER, window_height INTEGER, digest TEXT,
    PRIMARY KEY (participant, position)
) STRICT;
CREATE TABLE clicks (
    participant INTEGER NOT NULL, position INTEGER NOT NULL, slot INTEGER NOT NULL, x REAL, y REAL, at_ms INTEGER,
    PRIMARY KEY (participant, position, slot), FOREIGN KEY (participant, position) REFERENCES answers
) STRICT;
"""
# names and types of tables and columns; SQLite checks the types of values in strict tables
_COLUMNS = """
SELECT t.name, t.type, t.strict, c.name, c.type FROM pragma_table_list t JOIN pragma_table_info(t.name) c
"""


class AnswerStore:
    """An answer file that is open in the one process that writes to it. Threads share its connection."""

    def __init__(self, path: Path) -> None:
        """Open the file, or create it.

        Raises:
            CophyError: It is damaged, not an answer file, in use or not writable.
            OSError: The disk is full.
        """
        self._lock, self._path = threading.RLock(), path
        self._files: list[tuple[int, int] | None] | None = None  # see `_identify`; None until they exist
        with naming_file(path):
            self._connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=30)
            try:
                self._prepare(path)
            except BaseException:
                self._connection.close()
                raise
        self._files = self._identify()

    def _prepare(self, path: Path) -> None:
        self._connection.row_factory = sqlite3.Row
        (num_tables,) = self._connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
        if num_tables > 0:
            _check_tables(self._connection, path)
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            self._connection.execute(f"PRAGMA {pragma}")
        if num_tables == 0:
            with self.transaction() as db:
                for statement in SCHEMA.split(";\n"):
                    db.execute(statement)
                db.execute("PRAGMA user_version=1")  # version of the schema

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Write everything that is written inside to disk at the end, or nothing of it.

        Raises:
            CophyError: The file was moved, deleted or replaced, so that what was written may be lost.
        """
        with self._lock:
            with self._connection:  # it commits, or rolls back on an error
                self._connection.execute("BEGIN IMMEDIATE")
                yield self._connection
            if self._files not in (None, self._identify()):
                raise CophyError(f"{self._path} or its -wal was moved: put it back, or start the study again")

    def _identify(self) -> list[tuple[int, int] | None]:
        """Return device and inode of the file and its log; SQLite writes to the open files, wherever they are."""
        files: list[tuple[int, int] | None] = []
        for path in (self._path, f"{self._path}-wal"):
            try:
                status = os.stat(path)
            except FileNotFoundError:
                files.append(None)
            else:
                files.append((status.st_dev, status.st_ino))
        return files

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._connection.close()


@contextmanager
def open_answers(path: Path) -> Iterator[sqlite3.Connection]:
    """Open an answer file to read it, also while a study writes to it.

    Raises:
        CophyError: It is damaged, not an answer file, in use or not readable.
    """
    with naming_file(path), closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as db:
        _check_tables(db, path)
        yield db


def _check_tables(db: sqlite3.Connection, path: Path) -> None:
    """Check integrity and schema of an answer file."""
    with closing(sqlite3.connect(":memory:")) as expected:
        expected.executescript(SCHEMA)
        missing = set(expected.execute(_COLUMNS)) - {tuple(row) for row in db.execute(_COLUMNS)}
    if missing:
        raise damaged_error(path, f"table {min(missing)[0]} has other columns")
    (result,) = db.execute("PRAGMA quick_check(1)").fetchone()
    if result != "ok":
        raise damaged_error(path, result)


def damaged_error(path: Path, reason: object) -> CophyError:
    """Return the error of a file that cannot be used."""
    return CophyError(
        f"{path} is damaged or not an answer file ({' '.join(str(reason).split())}): "
        "move it away, or replace it with an intact copy"
    )


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Turn errors of SQLite that are due to the file, and not to the program, into one line that names the file.

    Raises:
        CophyError: The file is damaged, not an answer file, in use, or cannot be opened.
        OSError: The disk is full.
    """
    if path.exists() and not path.is_file():
        raise damaged_error(path, "not a regular file")
    try:
        yield
    except UnicodeDecodeError as error:
        raise damaged_error(path, error) from error
    except sqlite3.DatabaseError as error:
        check_space(path)
        name = getattr(error, "sqlite_errorname", "")
        if name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
            raise CophyError(f"{path} is in use by another program: end it, or try again") from error
        if name.startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB")) or "Could not decode" in str(error):
            raise damaged_error(path, error) from error
        if name.startswith(("SQLITE_CANTOPEN", "SQLITE_IOERR", "SQLITE_PERM", "SQLITE_READONLY")):
            raise CophyError(f"{path}: {error}; check the permissions of the file and its folder") from error
        raise


@contextmanager
def exclusive(path: Path) -> Iterator[None]:
    """Lock an answer file, since two processes that write to it would each number the participants.

    Raises:
        CophyError: Another process holds the lock.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    busy = f"{path} is being written by another process: set another folder with directory="
    with locked(path.with_name(f"{path.name}.lock"), elsewhere="directory=", busy=busy):
        yield
