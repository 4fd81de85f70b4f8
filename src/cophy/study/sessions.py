"""Progress of participants: their tasks, clocks and answers. The server decides about time and order; browsers only ask."""

import hashlib
import hmac
import json
import secrets
import sqlite3
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from cophy.study.answers import AnswerStore, RefusedError, check_answer
from cophy.study.experiments import StudyExperiments
from cophy.study.plan import StudyTask

NUM_TOKEN_BYTES = 32
CODE_LETTERS = "ABCDEFGHJKLMNPQRSTUVWXYZ23456789"  # no letters and digits that look alike
# the first number in the plan that is free: a new one, or that of a participant who was deleted
FREE_NUMBER = """
WITH taken AS (SELECT number FROM participants WHERE study=? AND kind=?)
SELECT min(number) FROM (SELECT 0 AS number UNION ALL SELECT number + 1 FROM taken)
WHERE number NOT IN (SELECT number FROM taken)
"""
PARTICIPANT = "SELECT id, number, code, platform_hash FROM participants WHERE token_hash=? AND study=? AND kind=?"


class Place(NamedTuple):
    """Position of a participant in the tasks.

    Attributes:
        participant: Id in the answer file.
        code: Completion code.
        tasks: All tasks of the participant, practice first.
        position: Index of the current task; the number of tasks at the end.
        remaining_s: Time left for the current task, None before its clock begins.
    """

    participant: int
    code: str
    tasks: list[StudyTask]
    position: int
    remaining_s: float | None

    @property
    def task(self) -> StudyTask | None:
        """The current task, None at the end."""
        return self.tasks[self.position] if self.position < len(self.tasks) else None


class Sessions:
    """All participants of one study and one kind: human participants, or one kind of simulated participants."""

    def __init__(self, store: AnswerStore, experiments: StudyExperiments, kind: str) -> None:
        self.store, self.experiments, self.kind = store, experiments, kind
        self.study, self.settings = experiments.study_id, experiments.settings
        offset = time.time() - time.monotonic()
        # setting the machine's clock moves no deadline
        self.now: Callable[[], float] = lambda: offset + time.monotonic()
        with store.transaction() as db:
            db.execute("INSERT OR IGNORE INTO studies VALUES (?, ?)", (self.study, experiments.description))

    def consent(self, platform_id: str | None, token: str | None = None) -> str:
        """Add a participant and return the token of the session. The answer file stores only hashes of token and id.

        Args:
            platform_id: Id of the participant on a crowd platform.
            token: Random token that the browser drew, so that a consent that is sent twice adds one participant.

        Raises:
            RefusedError: The id takes part already.
        """
        token, platform_hash = token or secrets.token_urlsafe(NUM_TOKEN_BYTES), self._platform_hash(platform_id)
        study_and_kind = (self.study, self.kind)
        with self.store.transaction() as db:
            if db.execute(PARTICIPANT, (_hash(token), *study_and_kind)).fetchone():
                return token
            same_id = "SELECT 1 FROM participants WHERE study=? AND kind=? AND platform_hash=?"
            if platform_hash and db.execute(same_id, (*study_and_kind, platform_hash)).fetchone():
                raise RefusedError(409, "This id takes part already. Please continue in the browser where you began.")
            (number,) = db.execute(FREE_NUMBER, study_and_kind).fetchone()
            code = "".join(secrets.choice(CODE_LETTERS) for _ in range(10))
            db.execute(
                "INSERT INTO participants (study, kind, number, token_hash, platform_hash, code, consented_at) "
                "VALUES (?, ?, ?, ?, ?, ?, ?)",
                (*study_and_kind, number, _hash(token), platform_hash, code, self.now()),
            )
        return token

    def place(self, token: str | None, platform_id: str | None = None) -> Place:
        """Return where the participant is. A task whose time is over is stored as late, without clicks.

        Args:
            platform_id: Id on a crowd platform, None if the browser sent none.

        Raises:
            RefusedError: There is no such session, or it belongs to another id.
        """
        with self.store.transaction() as db:
            return self._place(db, token, platform_id)

    def begin(self, token: str | None, position: int) -> Place:
        """Start the clock of the current task, once.

        Raises:
            RefusedError: Another task is the current one.
        """
        with self.store.transaction() as db:
            place = self._place(db, token)
            _check_current(place, position)
            if place.remaining_s is None:
                key = (place.participant, position)
                db.execute("UPDATE answers SET begun_at=? WHERE participant=? AND position=?", (self.now(), *key))
            return self._place(db, token)

    def answer(self, token: str | None, position: int, body: Any) -> StudyTask:
        """Store an answer and return its task. The same answer may be sent again and changes nothing.

        Args:
            position: Index of the task.
            body: Decoded JSON, see `check_answer`.

        Raises:
            RefusedError: It is not an answer or not the current task, its clock has not begun, or its time is over.
        """
        with self.store.transaction() as db:
            place = self._place(db, token)
            if 0 <= position < place.position:
                query = "SELECT digest FROM answers WHERE participant=? AND position=?"
                (digest,) = db.execute(query, (place.participant, position)).fetchone()
                if digest != _hash(json.dumps(body, sort_keys=True)):
                    raise RefusedError(409, "This task was answered already, or its time is over.")
                return place.tasks[position]
            _check_current(place, position)
            if place.remaining_s is None:
                raise RefusedError(409, "The clock of this task has not begun.")
            slots = self.experiments.scenes.slots(place.tasks[position].experiment)
            last_ms = round(1000 * (self.settings.seconds + self.settings.tolerance_s))
            check_answer(body, slots=slots, resolution=self.settings.resolution, last_ms=last_ms)
            self._write(db, place, body)
            return place.tasks[position]

    def _platform_hash(self, platform_id: str | None) -> str | None:
        key = self.study.encode()
        return None if platform_id is None else hmac.new(key, platform_id.encode(), hashlib.sha256).hexdigest()

    def _place(self, db: sqlite3.Connection, token: str | None, platform_id: str | None = None) -> Place:
        row = db.execute(PARTICIPANT, (_hash(token or ""), self.study, self.kind)).fetchone()
        if row is None or (platform_id and row["platform_hash"] != self._platform_hash(platform_id)):
            raise RefusedError(401, "There is no such session.")
        tasks = self.experiments.tasks(row["number"])
        answered = "SELECT count(*) FROM answers WHERE participant=? AND answered_at IS NOT NULL"
        (position,) = db.execute(answered, (row["id"],)).fetchone()
        while position < len(tasks):
            remaining_s = self._open(db, row["id"], position, tasks[position])
            place = Place(row["id"], row["code"], tasks, position, remaining_s)
            if remaining_s is None or remaining_s > -self.settings.tolerance_s:
                return place
            self._write(db, place, None)
            position += 1
        return Place(row["id"], row["code"], tasks, position, None)

    def _open(self, db: sqlite3.Connection, participant: int, position: int, task: StudyTask) -> float | None:
        """Store when a task was first opened, and return the seconds until its clock ends; None before it begins."""
        db.execute(
            "INSERT OR IGNORE INTO answers (participant, position, practice, experiment, setting, opened_at) "
            "VALUES (?, ?, ?, ?, ?, ?)",
            (participant, position, position < len(self.experiments.practice), *task, self.now()),
        )
        query = "SELECT begun_at FROM answers WHERE participant=? AND position=?"
        (begun_at,) = db.execute(query, (participant, position)).fetchone()
        # abs: a clock that was set back before a restart adds no time
        return None if begun_at is None else self.settings.seconds - abs(self.now() - begun_at)

    def _write(self, db: sqlite3.Connection, place: Place, answer: dict[str, Any] | None) -> None:
        """Store the answer to the current task; None is an answer that did not come in time."""
        key, now = (place.participant, place.position), self.now()
        details: tuple[object, ...] = (None,) * 6
        clicks: dict[int, tuple[object, ...]] = {}
        if answer is not None:
            digest = _hash(json.dumps(answer, sort_keys=True))
            details = (answer["undone"], answer["names_shown"], answer["input"], *answer["window"], digest)
            clicks = {click["slot"]: (click["x"], click["y"], click["at_ms"]) for click in answer["clicks"]}
        db.execute(
            "UPDATE answers SET answered_at=?, late=?, undone=?, names_shown=?, input=?, window_width=?, "
            "window_height=?, digest=? WHERE participant=? AND position=?",
            (now, answer is None, *details, *key),
        )
        for slot in sorted(self.experiments.scenes.slots(place.tasks[place.position].experiment)):
            values = clicks.get(slot, (None, None, None))
            db.execute("INSERT INTO clicks VALUES (?, ?, ?, ?, ?, ?)", (*key, slot, *values))
        if place.position + 1 == len(place.tasks):
            db.execute("UPDATE participants SET finished_at=? WHERE id=?", (now, place.participant))


def _check_current(place: Place, position: int) -> None:
    if place.task is None or position != place.position:
        raise RefusedError(409, "This is not the current task.")


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
