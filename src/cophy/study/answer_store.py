"""One SQLite file with participants, answers and clicks; docs/study.md explains its tables.

Every write is on disk before it is acknowledged (WAL, synchronous=FULL). One process writes, others may read.
"""

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cophy.errors import CophyError

SCHEMA_VERSION = 1
PERSON = "person"  # the kind of all who are not simulated
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


class AnswerStore:
    """The file, opened for the one process that writes to it. Its connection is shared by threads, one at a time."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = threading.RLock()
        self._connection = sqlite3.connect(path, check_same_thread=False, isolation_level=None, timeout=30)
        self._connection.row_factory = sqlite3.Row
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            self._connection.execute(f"PRAGMA {pragma}")
        with self.transaction() as connection:
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            if version == 0:
                for statement in SCHEMA.split(";\n"):
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
            elif version != SCHEMA_VERSION:
                raise CophyError(
                    f"{path} is of schema {version}, this program writes {SCHEMA_VERSION}: name another file"
                )

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """All that is written inside is on disk afterwards, or none of it."""
        with self._lock:
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
            except BaseException:
                self._connection.execute("ROLLBACK")
                raise
            self._connection.execute("COMMIT")

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._connection.close()
