"""A study that is served, and a window of Debian's Chromium (package chromium), driven by Playwright."""

import shutil
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import uvicorn
from playwright.sync_api import Page, ViewportSize, sync_playwright

from cophy.config import settings
from cophy.dataset.states import States
from cophy.study.answers import PERSON, AnswerStore
from cophy.study.server import open_study
from tests.conftest import tiny_spec
from tests.study.conftest import GENEROUS, SMALL, Site

CHROMIUM = shutil.which("chromium")
DESKTOP, PHONE = ViewportSize(width=1280, height=800), ViewportSize(width=360, height=640)


@pytest.fixture(scope="module")
def large_pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pictures")


@pytest.fixture
def served(tiny_data: Path, large_pictures: Path, tmp_path: Path) -> Iterator[tuple[Site, str]]:
    """A study with pictures of 448 × 448, and where it is."""
    store = AnswerStore(tmp_path / "answers.sqlite")
    states, large = States(tiny_spec("blocktower"), tiny_data), replace(SMALL, resolution=448, seconds=6)
    study = open_study(store, states, settings("study").split, large, large_pictures, kind=PERSON, workers=2)
    server = uvicorn.Server(uvicorn.Config(study.app(None, GENEROUS), port=0, log_level="warning"))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.05)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield Site(study, store, time.time), f"http://127.0.0.1:{port}"  # type: ignore[arg-type]
    server.should_exit = True
    thread.join()
    store.close()


@pytest.fixture
def page(request: pytest.FixtureRequest) -> Iterator[Page]:
    """A window of the size that a test asks for; errors of the page are failures."""
    is_phone = getattr(request, "param", "desktop") == "phone"
    if CHROMIUM is None:
        pytest.skip("needs Debian's package chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(viewport=PHONE if is_phone else DESKTOP, has_touch=is_phone, is_mobile=is_phone)
        opened = context.new_page()
        errors: list[str] = []
        opened.on("pageerror", lambda error: errors.append(str(error)))
        yield opened
        browser.close()
    assert errors == []
