"""Answers of participants: their checks, and the SQLite file that stores them.

docs/study.md explains the tables of the file.
"""

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from cophy.atomic_files import check_space
from cophy.errors import CophyError

ANSWERS, SIMULATED = "answers.sqlite", "simulated.sqlite"  # files of human and of simulated participants
PERSON = "person"  # kind of all participants who are not simulated
INPUT_DEVICES = ("mouse", "touch", "keyboard", "pen", "none")
MAX_UNDONE = 1000
MAX_WINDOW_PX = 20_000


class BadAnswerError(ValueError):
    """A browser sent something that is not a valid answer."""


@dataclass(frozen=True)
class Click:
    """Position where a participant expects an object to end.

    Attributes:
        x: Pixels of the image.
        y: Pixels of the image.
        at_ms: Milliseconds after the clock began.
    """

    x: float
    y: float
    at_ms: int


@dataclass(frozen=True)
class Answer:
    """Answer to one task.

    Attributes:
        clicks: By slot; slots that were not clicked are absent.
        undone: Number of clicks that were undone.
        names_shown: Whether the participant let the names be written on the objects.
        input: Device of the last click, one of INPUT_DEVICES.
        window: Width and height of the browser's window, CSS pixels.
    """

    clicks: dict[int, Click]
    undone: int
    names_shown: bool
    input: str
    window: tuple[int, int]


def parse_answer(body: Any, *, slots: set[int], resolution: int, last_ms: int) -> Answer:
    """Check what a browser sent and return it as an answer.

    Args:
        body: Decoded JSON.
        slots: Slots of the objects in C.
        resolution: Width and height of the image, pixels; clicks have to be inside.
        last_ms: Latest time of a click.

    Raises:
        BadAnswerError: It is not an answer.
    """
    if not isinstance(body, dict) or set(body) != {"clicks", "undone", "names_shown", "input", "window"}:
        raise BadAnswerError("not the fields of an answer")
    if not isinstance(body["clicks"], list) or len(body["clicks"]) > len(slots):
        raise BadAnswerError("clicks: at most one per object")
    clicks = dict(_parse_click(click, slots, resolution, last_ms) for click in body["clicks"])
    if len(clicks) != len(body["clicks"]):
        raise BadAnswerError("clicks: two for one object")
    if not isinstance(body["names_shown"], bool) or body["input"] not in INPUT_DEVICES:
        raise BadAnswerError("names_shown or input")
    if not isinstance(body["window"], list) or len(body["window"]) != 2:
        raise BadAnswerError("window: width and height")
    width, height = (int(_check_number(side, 1, MAX_WINDOW_PX, int)) for side in body["window"])
    undone = int(_check_number(body["undone"], 0, MAX_UNDONE, int))
    return Answer(clicks, undone, body["names_shown"], body["input"], (width, height))


def _parse_click(body: Any, slots: set[int], resolution: int, last_ms: int) -> tuple[int, Click]:
    if not isinstance(body, dict) or set(body) != {"slot", "x", "y", "at_ms"}:
        raise BadAnswerError("not the fields of a click")
    slot = int(_check_number(body["slot"], 0, max(slots), int))
    if slot not in slots:
        raise BadAnswerError("slot: there is no such object in this image")
    x, y = (_check_number(body[axis], 0, resolution) for axis in "xy")
    return slot, Click(x, y, int(_check_number(body["at_ms"], 0, last_ms, int)))


def _check_number(value: Any, low: float, high: float, kinds: Any = (int, float)) -> float:
    if isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high:  # NaN is not between
        raise BadAnswerError("a number is missing or out of its range")
    return float(value)


SCHEMA_VERSION = 1
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
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = threading.RLock()
        with naming_file(path):
            self._connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=30)
            try:
                self._prepare(path)
            except BaseException:
                self._connection.close()
                raise

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
                db.execute(f"PRAGMA user_version={SCHEMA_VERSION}")

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Write everything that is written inside to disk at the end, or nothing of it."""
        with self._lock:
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:  # a full disk may have ended it
                    self._connection.execute("ROLLBACK")
                raise

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
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if version not in (0, SCHEMA_VERSION):
        raise CophyError(
            f"{path} has schema version {version}, but this program writes version {SCHEMA_VERSION}: "
            "set another folder with directory="
        )
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
    """Name the answer file in errors of SQLite that are due to the file and not to the program.

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
    try:
        with FileLock(f"{path}.lock", timeout=0):
            yield
    except Timeout:
        raise CophyError(f"{path} is being written by another process: set another folder with directory=") from None


def remove_journal(path: Path) -> None:
    """Delete the journal of a file that is about to be replaced: SQLite would apply it to the new file."""
    for suffix in ("-wal", "-shm"):
        path.with_name(f"{path.name}{suffix}").unlink(missing_ok=True)
