"""Where a participant is, and what may come next. Time and order are the server's; a browser only asks.

Which experiments a participant sees, in which setting and order: a pure function of the seed and the number.

Twin pairs are dealt to m = num_pairs / num_assignments hands, every kind of pair evenly. Participant n has one hand in the
setting without AB, and the next in the setting with AB. After 2 m participants every experiment was seen once in each setting.
"""

import hashlib
import hmac
import json
import secrets
import sqlite3
import time
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from cophy.errors import CophyError
from cophy.study.answers import Answer, AnswerStore, parse
from cophy.study.settings import SETTINGS, StudySettings


class Assignment(NamedTuple):
    """One experiment that a participant is asked about, in one of SETTINGS."""

    experiment: int
    setting: str


def chosen_pairs(pairs: np.ndarray, kinds: np.ndarray, settings: StudySettings) -> np.ndarray:
    """(num_pairs,) of the given pairs: every kind with its share of all.

    Args:
        pairs: (pair,) index in the dataset.
        kinds: (pair, 2) cells of the twins.
        settings: Of the study.

    Raises:
        CophyError: There are fewer.
    """
    if len(pairs) < settings.num_pairs:
        raise CophyError(
            f"the test split has {len(pairs)} twin pairs, study.num_pairs={settings.num_pairs} asks for more: "
            "take a larger size=, or a smaller study.num_pairs= and study.num_assignments="
        )
    order = _by_kind(kinds, np.random.default_rng((settings.seed, 0)))
    return np.sort(pairs[order[np.arange(settings.num_pairs) * len(pairs) // settings.num_pairs]])


def assignments_of(number: int, pairs: np.ndarray, kinds: np.ndarray, settings: StudySettings) -> list[Assignment]:
    """What participant `number` (from 0) is asked, in order.

    Args:
        number: Of the participant.
        pairs: (num_pairs,) see `chosen_pairs`.
        kinds: (num_pairs, 2) cells of their twins.
        settings: Of the study.
    """
    num_hands = len(pairs) // settings.num_assignments
    deck, place = divmod(number, num_hands)
    rng = np.random.default_rng((settings.seed, 1, deck // 2))  # decks 2 d and 2 d + 1 show complementary twins
    order = _by_kind(kinds, rng)
    twin = (np.arange(len(order)) // num_hands + rng.integers(2, size=num_hands)[_hand(order, num_hands)] + deck) % 2
    experiments = 2 * pairs[order] + twin
    found = [
        Assignment(int(experiment), setting)
        for shift, setting in enumerate(SETTINGS)
        for experiment in experiments[_hand(order, num_hands) == (place + shift) % num_hands]
    ]
    mixed = np.random.default_rng((settings.seed, 2, number)).permutation(len(found))
    return [found[index] for index in mixed]


def practice(pairs: np.ndarray, settings: StudySettings) -> list[Assignment]:
    """One of each setting, the same for all participants.

    Args:
        pairs: (pair,) index in the dataset; none of the test split.
        settings: Of the study.
    """
    rng = np.random.default_rng((settings.seed, 3))
    chosen: Sequence[int] = rng.permutation(pairs)[: len(SETTINGS)].tolist()
    return [
        Assignment(2 * pair + int(rng.integers(2)), setting) for pair, setting in zip(chosen, SETTINGS, strict=True)
    ]


def _by_kind(kinds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(pair,) places in random order, those of one kind side by side."""
    return np.lexsort((rng.random(len(kinds)), kinds[:, 1], kinds[:, 0]))


def _hand(order: np.ndarray, num_hands: int) -> np.ndarray:
    """(pair,) the hand that each card of a deck is dealt to, one after the other."""
    return np.arange(len(order)) % num_hands


NUM_TOKEN_BYTES = 32
CODE_LETTERS = "ABCDEFGHJKLMNPQRSTUVWXYZ23456789"  # none that look alike
# the first place in the plan that nobody has: a new one, or that of a participant who was deleted
FREE_NUMBER = """
WITH taken AS (SELECT number FROM participants WHERE study=? AND kind=?)
SELECT min(number) FROM (SELECT 0 AS number UNION ALL SELECT number + 1 FROM taken)
WHERE number NOT IN (SELECT number FROM taken)
"""

OF_TOKEN = "SELECT id, code, platform_hash FROM participants WHERE token_hash=? AND study=? AND kind=?"


class RefusedError(Exception):
    """What a browser asked for is not allowed; `status` is of HTTP."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


class Place(NamedTuple):
    """Where a participant is: at `position` of all, or through with everything, where `assignment` is None."""

    participant: int
    position: int
    assignment: Assignment | None
    remaining_s: float | None  # None before the clock began
    code: str


class Sessions:
    """All participants of one study and one kind: people, or one kind of simulated ones."""

    def __init__(
        self,
        store: AnswerStore,
        settings: StudySettings,
        *,
        study: str,
        kind: str,
        description: str,
        practice: Sequence[Assignment],
        plan: Callable[[int], Sequence[Assignment]],
        slots_of: Callable[[int], set[int]],
    ) -> None:
        self.store, self.settings, self.study, self.kind = store, settings, study, kind
        self.practice, self.slots_of, self.now = list(practice), slots_of, time.time
        self._plan = plan
        with store.transaction() as db:
            db.execute("INSERT OR IGNORE INTO studies VALUES (?, ?)", (study, description))

    def of_kind(self, kind: str) -> "Sessions":
        """The same study for another kind of participants."""
        other = copy(self)
        other.kind = kind
        return other

    @property
    def num_positions(self) -> int:
        """Practice and assignments of one participant."""
        return len(self.practice) + self.settings.num_per_person

    def consent(self, platform_id: str | None, token: str | None = None) -> str:
        """A new participant's token, which nobody can guess; only its hash is kept, and that of the platform's id.

        Args:
            platform_id: As a crowd platform calls the participant.
            token: That the browser drew, so that a consent that is sent twice begins once; None for a new one.

        Raises:
            RefusedError: the platform's id takes part already.
        """
        token, platform = token or secrets.token_urlsafe(NUM_TOKEN_BYTES), self._platform_hash(platform_id)
        with self.store.transaction() as db:
            of_study = (self.study, self.kind)
            if db.execute(OF_TOKEN, (_hash(token), *of_study)).fetchone():
                return token
            same = "SELECT 1 FROM participants WHERE study=? AND kind=? AND platform_hash=?"
            if platform and db.execute(same, (*of_study, platform)).fetchone():
                raise RefusedError(409, "This id takes part already. Go on in the browser where you began.")
            number = db.execute(FREE_NUMBER, of_study).fetchone()[0]
            code = "".join(secrets.choice(CODE_LETTERS) for _ in range(10))
            db.execute(
                "INSERT INTO participants (study, kind, number, token_hash, platform_hash, code, consented_at) "
                "VALUES (?, ?, ?, ?, ?, ?, ?)",
                (*of_study, number, _hash(token), platform, code, self.now()),
            )
        return token

    def place(self, token: str | None, platform_id: str | None = None) -> Place:
        """Where the participant is. An assignment whose time is over counts as answered without clicks.

        Args:
            token: Of the participant.
            platform_id: As a crowd platform calls whoever asks; None where nobody says.

        Raises:
            RefusedError: nobody has this token, or somebody with another id.
        """
        with self.store.transaction() as db:
            return self._place(db, token, platform_id)

    def begin(self, token: str | None, position: int) -> Place:
        """The clock of the current assignment begins, once.

        Raises:
            RefusedError: it is not the current one.
        """
        with self.store.transaction() as db:
            place = self._place(db, token)
            self._check_current(place, position)
            if place.remaining_s is None:
                key = (place.participant, position)
                db.execute("UPDATE answers SET begun_at=? WHERE participant=? AND position=?", (self.now(), *key))
            return self._place(db, token)

    def answer(self, token: str | None, position: int, body: Any) -> tuple[Assignment, bool]:
        """Store an answer. The same one again changes nothing and is acknowledged again.

        Args:
            token: Of the participant.
            position: Of the assignment.
            body: Decoded JSON, see `parse`.

        Returns:
            The assignment, and whether it is practice.

        Raises:
            RefusedError: It is not the current one, not begun, or its time is over.
            BadAnswerError: It is no answer.
        """
        with self.store.transaction() as db:
            place = self._place(db, token)
            plan = self._assignments(db, place.participant)
            if 0 <= position < place.position:
                return plan[position], self._check_same(db, place, position, body, plan[position])
            self._check_current(place, position)
            if place.remaining_s is None:
                raise RefusedError(409, "The clock of this assignment has not begun.")
            answer = self._parse(body, plan[position])
            self._write(db, (place.participant, position), answer, self.slots_of(plan[position].experiment))
            if position + 1 == self.num_positions:
                db.execute("UPDATE participants SET finished_at=? WHERE id=?", (self.now(), place.participant))
            return plan[position], position < len(self.practice)

    def _platform_hash(self, platform_id: str | None) -> str | None:
        key = self.study.encode()
        return None if platform_id is None else hmac.new(key, platform_id.encode(), hashlib.sha256).hexdigest()

    def _parse(self, body: Any, assignment: Assignment) -> Answer:
        last_ms = round(1000 * (self.settings.seconds + self.settings.tolerance_s))
        slots = self.slots_of(assignment.experiment)
        return parse(body, slots=slots, resolution=self.settings.resolution, last_ms=last_ms)

    def _check_same(
        self, db: sqlite3.Connection, place: Place, position: int, body: Any, assignment: Assignment
    ) -> bool:
        """Whether it is practice; refused where it is not what was stored."""
        row = db.execute(
            "SELECT digest, practice FROM answers WHERE participant=? AND position=?", (place.participant, position)
        ).fetchone()
        if row["digest"] is None or row["digest"] != _digest(self._parse(body, assignment)):
            raise RefusedError(409, "This assignment was answered already, or its time is over.")
        return bool(row["practice"])

    def _place(self, db: sqlite3.Connection, token: str | None, platform_id: str | None = None) -> Place:
        found = db.execute(OF_TOKEN, (_hash(token or ""), self.study, self.kind)).fetchone()
        if found is None or (platform_id and found["platform_hash"] != self._platform_hash(platform_id)):
            raise RefusedError(401, "There is no such session.")
        participant = int(found["id"])
        while True:
            position = db.execute(
                "SELECT count(*) FROM answers WHERE participant=? AND answered_at IS NOT NULL", (participant,)
            ).fetchone()[0]
            if position == self.num_positions:
                return Place(participant, position, None, None, found["code"])
            assignment = self._assignments(db, participant)[position]
            remaining_s = self._remaining(db, participant, position, assignment)
            if remaining_s is None or remaining_s > -self.settings.tolerance_s:
                return Place(participant, position, assignment, remaining_s, found["code"])
            self._write(db, (participant, position), None, self.slots_of(assignment.experiment))
            if position + 1 == self.num_positions:
                db.execute("UPDATE participants SET finished_at=? WHERE id=?", (self.now(), participant))

    def _remaining(
        self, db: sqlite3.Connection, participant: int, position: int, assignment: Assignment
    ) -> float | None:
        """Seconds until the clock ends; None where it has not begun. Notes when an assignment was first opened."""
        db.execute(
            "INSERT OR IGNORE INTO answers (participant, position, practice, experiment, setting, opened_at) "
            "VALUES (?, ?, ?, ?, ?, ?)",
            (participant, position, position < len(self.practice), *assignment, self.now()),
        )
        begun = db.execute(
            "SELECT begun_at FROM answers WHERE participant=? AND position=?", (participant, position)
        ).fetchone()[0]
        return None if begun is None else self.settings.seconds - (self.now() - begun)

    def _assignments(self, db: sqlite3.Connection, participant: int) -> list[Assignment]:
        number = db.execute("SELECT number FROM participants WHERE id=?", (participant,)).fetchone()[0]
        return [*self.practice, *self._plan(number)]

    @staticmethod
    def _check_current(place: Place, position: int) -> None:
        if place.assignment is None or position != place.position:
            raise RefusedError(409, "This is not the assignment that is next.")

    def _write(self, db: sqlite3.Connection, key: tuple[int, int], answer: Answer | None, slots: set[int]) -> None:
        """An answer, or None for one that did not come in time."""
        said: tuple[object, ...] = (None,) * 6
        if answer is not None:
            said = (answer.undone, answer.names_shown, answer.input, *answer.window, _digest(answer))
        db.execute(
            "UPDATE answers SET answered_at=?, late=?, undone=?, names_shown=?, input=?, window_width=?, "
            "window_height=?, digest=? WHERE participant=? AND position=?",
            (self.now(), answer is None, *said, *key),
        )
        clicks = {} if answer is None else answer.clicks
        for slot in sorted(slots):
            where = (clicks[slot].x, clicks[slot].y, clicks[slot].at_ms) if slot in clicks else (None,) * 3
            db.execute("INSERT INTO clicks VALUES (?, ?, ?, ?, ?, ?)", (*key, slot, *where))


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def _digest(answer: Answer) -> str:
    return hashlib.sha256(json.dumps(asdict(answer), sort_keys=True).encode()).hexdigest()
