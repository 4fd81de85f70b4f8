"""A study on the tiny block towers with images of 64 × 64, and browsers that take part in it over HTTP."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pandas as pd
import pytest
from starlette.applications import Starlette
from starlette.testclient import TestClient
from uvicorn import Config, Server

from cophy.config import settings
from cophy.dataset.states import States
from cophy.study import experiments as experiments_module
from cophy.study.answers import PERSON, AnswerStore
from cophy.study.experiments import StudyExperiments
from cophy.study.judging import read_judged
from cophy.study.plan import Limits, StudySettings
from cophy.study.server import listen, make_app, serve, welcome_text
from cophy.study.sessions import Sessions
from tests.conftest import tiny_spec

HOSTS = ("testserver", "study.example")
GENEROUS = Limits(requests_per_second=10_000, people_per_minute=10_000)
SMALL = StudySettings(seed=0, num_pairs=2, num_assignments=1, seconds=10.0, tolerance_s=3.0, resolution=64)


class Clock:
    """A clock that stands still until a test moves it."""

    def __init__(self) -> None:
        self.now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Site:
    """A study, its answer file and its clock."""

    sessions: Sessions
    path: Path
    clock: Clock = field(default_factory=Clock)
    limits: Limits = field(default_factory=lambda: GENEROUS)

    def __post_init__(self) -> None:
        self.sessions.now = self.clock

    def app(self) -> Starlette:
        return make_app(self.sessions, welcome_text(None, self.sessions.settings), self.limits, HOSTS)

    def browser(self, **options: Any) -> TestClient:
        """Return a browser without a session."""
        return TestClient(self.app(), **options)

    def participant(self) -> TestClient:
        """Return a browser whose participant has agreed."""
        browser = self.browser()
        assert browser.post("/api/consent", json={"agreed": True}).status_code == 200
        return browser

    def begun(self) -> tuple[TestClient, dict[str, Any]]:
        """Return a browser in which the clock of the first task runs, and a valid answer to the task."""
        browser = self.participant()
        answer = answer_to(browser.get("/api/place").json())
        browser.post("/api/assignments/0/begin", json={})
        return browser, answer

    def rows(self, query: str) -> list[tuple[Any, ...]]:
        """Return the rows of the answer file that a query selects."""
        with self.sessions.store.transaction() as db:
            return [tuple(row) for row in db.execute(query)]


@pytest.fixture(scope="session")
def experiments(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> StudyExperiments:
    """The experiments of the small study, with images that are drawn once, without processes that import everything again."""
    states, split = States(tiny_spec("blocktower"), tiny_data), settings("study").split
    study = StudyExperiments(states, split, SMALL, tmp_path_factory.mktemp("study"))
    with patch.object(experiments_module, "worker_pool", lambda workers: ThreadPoolExecutor(1)):
        study.draw_missing(workers=1)
    return study


@pytest.fixture
def site(experiments: StudyExperiments, tmp_path: Path) -> Iterator[Site]:
    path = tmp_path / "answers.sqlite"
    store = AnswerStore(path)
    yield Site(Sessions(store, experiments, PERSON), path)
    store.close()


@contextmanager
def serving(site: Site) -> Iterator[tuple[str, int]]:
    """Serve a study in a thread, as study.py does; yield its host and port."""
    servers: list[Server] = []

    def make_server(config: Config) -> Server:
        servers.append(Server(config))
        return servers[-1]

    with listen("127.0.0.1", 0) as listener, patch("uvicorn.Server", make_server):
        thread = threading.Thread(target=serve, args=(site.app(), listener, ""))
        thread.start()
        try:
            yield listener.getsockname()
        finally:
            servers[0].should_exit = True
            thread.join()


def judged_of(path: Path, experiments: StudyExperiments) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return participants and judged clicks of a study."""
    return read_judged(path, experiments.states, experiments.split, experiments.settings)


def answer_to(place: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Return an answer with a click in the image on every object."""
    clicks = [{"slot": item["slot"], "x": 31.5, "y": 20, "at_ms": 900} for item in place["objects"]]
    content = {"clicks": clicks, "undone": 0, "names_shown": False, "input": "mouse", "window": [800, 600]}
    return content | changes


def take_task(browser: TestClient, **changes: Any) -> dict[str, Any]:
    """Answer the current task and return what the server responds."""
    place = browser.get("/api/place").json()
    browser.post(f"/api/assignments/{place['position']}/begin", json={})
    response = browser.post(f"/api/assignments/{place['position']}/answer", json=answer_to(place, **changes))
    assert response.status_code == 200, response.text
    return dict(response.json())
