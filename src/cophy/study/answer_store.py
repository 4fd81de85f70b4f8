"""One SQLite file with participants, answers and clicks.

Every write is on disk before it is acknowledged (WAL, synchronous=FULL). One process writes, others may read.
"""

import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cophy.study.answer_tables import SCHEMA, SCHEMA_VERSION, check, naming

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
