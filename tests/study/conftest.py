"""A study on the tiny towers, with pictures of 64 × 64, and people who take it over HTTP."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from httpx import Response
from starlette.testclient import TestClient

from cophy.config import settings
from cophy.dataset.states import States
from cophy.study.answers import PERSON, AnswerStore
from cophy.study.server import OpenStudy, open_study
from cophy.study.settings import Limits, StudySettings
from tests.conftest import tiny_spec

GENEROUS = Limits(requests_per_second=10_000, people_per_minute=10_000)
SMALL = StudySettings(seed=0, num_pairs=2, num_assignments=1, seconds=10.0, tolerance_s=3.0, resolution=64)


class Time:
    """A clock that stands still until it is moved."""

    def __init__(self) -> None:
        self.now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Site:
    """A study, its file, and its time."""

    study: OpenStudy
    store: AnswerStore
    time: Time
    limits: Limits = field(default_factory=lambda: GENEROUS)

    def visitor(self, **options: Any) -> TestClient:
        """A browser of its own."""
        return TestClient(self.study.app(None, self.limits), **options)

    def participant(self) -> TestClient:
        """One who agreed."""
        browser = self.visitor()
        assert browser.post("/api/consent", json={"agreed": True}).status_code == 200
        return browser

    def rows(self, query: str) -> list[tuple[Any, ...]]:
        with self.store.transaction() as db:
            return [tuple(row) for row in db.execute(query)]


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where pictures are kept, so that they are drawn once."""
    return tmp_path_factory.mktemp("study")


def opened(path: Path, data: Path, pictures: Path, time: Time) -> Site:
    store = AnswerStore(path)
    split = settings("study").split
    study = open_study(store, States(tiny_spec("blocktower"), data), split, SMALL, pictures, kind=PERSON, workers=2)
    study.sessions.now = time
    return Site(study, store, time)


@pytest.fixture
def site(tiny_data: Path, pictures: Path, tmp_path: Path) -> Iterator[Site]:
    found = opened(tmp_path / "answers.sqlite", tiny_data, pictures, Time())
    yield found
    found.store.close()


def answer_to(place: dict[str, Any], **changed: Any) -> dict[str, Any]:
    """Clicks in the middle of the picture on every object."""
    clicks = [{"slot": each["slot"], "x": 31.5, "y": 20, "at_ms": 900} for each in place["objects"]]
    content = {"clicks": clicks, "undone": 0, "names_shown": False, "input": "mouse", "window": [800, 600]}
    return content | changed


def take_one(browser: TestClient) -> dict[str, Any]:
    """Answer what is next; what the server says to it."""
    place = browser.get("/api/place").json()
    browser.post(f"/api/assignments/{place['position']}/begin", json={})
    response = browser.post(f"/api/assignments/{place['position']}/answer", json=answer_to(place))
    assert response.status_code == 200, response.text
    return dict(response.json())


def has_its_headers(response: Response) -> bool:
    headers = response.headers
    policy = headers["content-security-policy"]
    safe = "script-src 'self';" in policy and "default-src 'none'" in policy
    return safe and headers["cache-control"] == "no-store" and headers["x-content-type-options"] == "nosniff"
