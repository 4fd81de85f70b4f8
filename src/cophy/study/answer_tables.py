"""The tables of a file of answers, and whether a file is one: docs/study.md explains them."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from cophy.atomic_files import check_space
from cophy.errors import CophyError

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
