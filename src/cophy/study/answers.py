"""One SQLite file with participants, answers and clicks.

What a person says of one experiment, checked before anything is stored.
The tables of a file of answers, and whether a file is one: docs/study.md explains them.
"""

import math
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cophy.atomic_files import check_space
from cophy.errors import CophyError

INPUTS = ("mouse", "touch", "keyboard", "pen", "none")
MAX_UNDONE = 1000
MAX_WINDOW_PX = 20_000


class BadAnswerError(ValueError):
    """What a browser sent is no answer."""


@dataclass(frozen=True)
class Click:
    """Where a person says that an object ends: pixels of the picture; at_ms after the clock began."""

    x: float
    y: float
    at_ms: int


@dataclass(frozen=True)
class Answer:
    """Of one assignment.

    clicks: by slot; a slot that was not clicked is absent. undone: clicks that were taken back. names_shown: whether the
    person let the names be written on the objects. input: of the last click. window: width and height, CSS pixels.
    """

    clicks: dict[int, Click]
    undone: int
    names_shown: bool
    input: str
    window: tuple[int, int]


def parse(body: Any, *, slots: set[int], resolution: int, last_ms: int) -> Answer:
    """The answer in what a browser sent.

    Args:
        body: Decoded JSON.
        slots: Of the objects in C.
        resolution: Of the picture; clicks have to be inside.
        last_ms: When the last click may be.

    Raises:
        BadAnswerError: It is none.
    """
    if not isinstance(body, dict) or set(body) != {"clicks", "undone", "names_shown", "input", "window"}:
        raise BadAnswerError("not the fields of an answer")
    if not isinstance(body["clicks"], list) or len(body["clicks"]) > len(slots):
        raise BadAnswerError("clicks: at most one per object")
    clicks = dict(_click(each, slots, resolution, last_ms) for each in body["clicks"])
    if len(clicks) != len(body["clicks"]):
        raise BadAnswerError("clicks: two for one object")
    if not isinstance(body["names_shown"], bool) or body["input"] not in INPUTS:
        raise BadAnswerError("names_shown or input")
    window = body["window"]
    if not isinstance(window, list) or len(window) != 2:
        raise BadAnswerError("window: width and height")
    width, height = (int(_number(side, 1, MAX_WINDOW_PX, whole=True)) for side in window)
    undone = int(_number(body["undone"], 0, MAX_UNDONE, whole=True))
    return Answer(clicks, undone, body["names_shown"], body["input"], (width, height))


def _click(body: Any, slots: set[int], resolution: int, last_ms: int) -> tuple[int, Click]:
    if not isinstance(body, dict) or set(body) != {"slot", "x", "y", "at_ms"}:
        raise BadAnswerError("not the fields of a click")
    slot = int(_number(body["slot"], 0, 1000, whole=True))
    if slot not in slots:
        raise BadAnswerError("slot: no such object in this picture")
    x, y = (_number(body[axis], 0, resolution) for axis in "xy")
    return slot, Click(x, y, int(_number(body["at_ms"], 0, last_ms, whole=True)))


def _number(value: Any, smallest: float, largest: float, *, whole: bool = False) -> float:
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
        raise BadAnswerError("not a number")
    if not smallest <= value <= largest or not math.isfinite(value):
        raise BadAnswerError("a number out of its range")
    return float(value)


ANSWERS, SIMULATED = "answers.sqlite", "simulated.sqlite"  # names of files: of people, and of simulated participants
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
# what the tables of a file are; SQLite checks the types of a strict one
TABLES = """
SELECT t.name, t.type, t.strict, c.name, c.type FROM pragma_table_list t JOIN pragma_table_info(t.name) c
"""


def damaged(path: Path, why: object) -> CophyError:
    """The error of a file that cannot be used."""
    said = f"{path} is no file of answers, or damaged ({' '.join(str(why).split())})"
    return CophyError(f"{said}: move it away, or put a sound copy in its place")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """What SQLite cannot do inside is said with the name of the file.

    Raises:
        CophyError: The file is none of answers, damaged, or in use.
        OSError: The disk is full.
    """
    if path.exists() and not path.is_file():
        raise damaged(path, "it is no plain file")
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:  # the second where it names what is no text
        check_space(path)
        if "locked" in str(error):
            raise CophyError(f"{path} is in use by another program: end that, or try again") from error
        raise damaged(path, error) from error


def check(connection: sqlite3.Connection, path: Path) -> None:
    """Nothing is read from a file, or written to it, that is not sound, or whose tables are others.

    Raises:
        CophyError: It is such a one.
        sqlite3.Error: Likewise.
    """
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version not in (0, SCHEMA_VERSION):
        raise CophyError(f"{path} is of schema {version}, this program writes {SCHEMA_VERSION}: name another folder")
    with closing(sqlite3.connect(":memory:")) as ours:
        ours.executescript(SCHEMA)
        missing = set(ours.execute(TABLES)) - {tuple(row) for row in connection.execute(TABLES)}
    if missing:
        raise damaged(path, f"its table {min(missing)[0]} is not as study.py makes it")
    (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if found != "ok":
        raise damaged(path, found)


def remove_journal(path: Path) -> None:
    """Of a file that is about to be replaced: SQLite would take it for the new one's."""
    for suffix in ("-wal", "-shm"):
        path.with_name(f"{path.name}{suffix}").unlink(missing_ok=True)


PERSON = "person"  # the kind of all who are not simulated


class AnswerStore:
    """The file, opened for the one process that writes to it. Its connection is shared by threads, one at a time."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = threading.RLock()
        with naming(path):
            self._connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=30)
            try:
                self._begin(path)
            except BaseException:
                self._connection.close()
                raise

    def _begin(self, path: Path) -> None:
        self._connection.row_factory = sqlite3.Row
        (num_tables,) = self._connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
        if num_tables > 0:
            check(self._connection, path)
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            self._connection.execute(f"PRAGMA {pragma}")
        if num_tables == 0:
            with self.transaction() as connection:
                for statement in SCHEMA.split(";\n"):
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """All that is written inside is on disk afterwards, or none of it."""
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
