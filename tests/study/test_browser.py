"""A real browser takes the study, from consent to the code: Debian's Chromium (package chromium), driven by Playwright."""

import shutil
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import uvicorn
from playwright.sync_api import Page, Route, ViewportSize, sync_playwright

from cophy.app.composition import settings
from cophy.dataset.store.states import States
from cophy.study.answer_store import PERSON, AnswerStore
from cophy.study.pages.serving import open_study
from tests.conftest import tiny_spec
from tests.study.conftest import GENEROUS, SMALL, Site

CHROMIUM = shutil.which("chromium")
DESKTOP, PHONE = ViewportSize(width=1280, height=800), ViewportSize(width=360, height=640)
CASES = [("desktop", "mouse"), ("desktop", "keyboard"), ("phone", "touch"), ("phone", "keyboard")]
START = 224  # where the cross of the keyboard begins: the middle of the picture
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's package chromium"),
]


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
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(viewport=PHONE if is_phone else DESKTOP, has_touch=is_phone, is_mobile=is_phone)
        opened = context.new_page()
        errors: list[str] = []
        opened.on("pageerror", lambda error: errors.append(str(error)))
        yield opened
        browser.close()
    assert errors == []


def press(page: Page, selector: str, by: str) -> None:
    """A button, as a person would."""
    button = page.locator(selector)
    button.wait_for()
    if by == "keyboard":
        for _ in range(12):
            page.keyboard.press("Tab")
            if button.evaluate("button => button === document.activeElement"):
                break
        page.keyboard.press("Enter")
    elif by == "touch":
        button.tap()
    else:
        button.click()


def place_all(page: Page, by: str, shots: Path) -> None:
    """Say of every object that it ends near the middle, one beside the other, and take one back once."""
    page.locator(".buttons .undo[disabled]").wait_for()
    page.wait_for_function("document.querySelector('.say strong')")
    count = page.locator(".objects li").count()
    for number in range(count):
        if by == "keyboard":
            page.keyboard.press("ArrowRight")
            page.keyboard.press("Enter")
        else:
            board = page.locator(".board").bounding_box()
            assert board is not None
            at = {"x": board["width"] / 2 + 10 * number, "y": board["height"] / 2}
            (page.locator(".board").tap if by == "touch" else page.locator(".board").click)(position=at)  # type: ignore[operator]
        if number == 0:
            page.keyboard.press("Backspace") if by == "keyboard" else press(page, ".undo", by)
            assert page.locator(".objects .set").count() == 0
            page.keyboard.press("Enter") if by == "keyboard" else page.locator(".board").click(position=at)
    page.screenshot(path=shots / f"placed-{time.time():.0f}.png")
    page.keyboard.press("d") if by == "keyboard" else press(page, ".done", by)


def all_in_sight(page: Page) -> list[str]:
    """Which of the things that a task needs are not wholly in the window."""
    size = page.viewport_size
    assert size is not None
    hidden = []
    for name in (".say", ".frame", ".clock", ".objects", ".undo", ".label", ".done"):
        box = page.locator(name).bounding_box()
        inside = box and box["y"] >= 0 and box["y"] + box["height"] <= size["height"] + 0.5
        if not (box and inside and box["x"] >= 0 and box["x"] + box["width"] <= size["width"] + 0.5):
            hidden.append(f"{name} {box}")
    return hidden


@pytest.mark.parametrize(("page", "by"), CASES, indirect=["page"])
def test_from_consent_to_code(page: Page, by: str, served: tuple[Site, str], tmp_path: Path) -> None:
    site, address = served
    page.goto(f"{address}/?participant=somebody")
    page.screenshot(path=tmp_path / "welcome.png")
    press(page, "text=I agree, begin", by)
    for position in range(4):
        if position < 2:
            press(page, "button:has-text('Ready')", by)
        if position == 2:
            press(page, "button:has-text('Begin')", by)
        page.wait_for_selector(".say strong", timeout=20_000)
        assert all_in_sight(page) == []
        place_all(page, by, tmp_path)
        if position < 2:
            page.locator("text=the large circles show").wait_for()
            page.screenshot(path=tmp_path / f"practice-{position}.png")
            press(page, "button:has-text('Continue')", by)
    code = page.locator(".code").inner_text()
    page.screenshot(path=tmp_path / "code.png")
    assert site.rows("SELECT code, finished_at IS NOT NULL FROM participants") == [(code, 1)]
    assert site.rows("SELECT count(*), sum(late), min(undone) FROM answers") == [(4, 0, 1)]
    assert site.rows("SELECT DISTINCT input FROM answers") == [(by,)]
    missing, low, high = site.rows("SELECT sum(x IS NULL), min(x), max(x) FROM clicks")[0]
    assert missing == 0
    assert START - 2 <= low <= high <= START + 40


def test_time_runs_out_and_what_is_missing_is_stored(page: Page, served: tuple[Site, str]) -> None:
    site, address = served
    page.goto(address)
    press(page, "text=I agree, begin", "mouse")
    press(page, "button:has-text('Ready')", "mouse")
    page.wait_for_selector(".say strong", timeout=20_000)
    page.locator(".board").click(position={"x": 100, "y": 100})
    page.locator("text=the large circles show").wait_for(timeout=15_000)
    present = len(site.study.experiments.scenes.slots(site.study.experiments.practice[0].experiment))
    assert site.rows("SELECT late FROM answers WHERE answered_at IS NOT NULL") == [(0,)]
    assert site.rows("SELECT count(*), sum(x IS NULL) FROM clicks") == [(present, present - 1)]


def test_a_browser_that_comes_back_goes_on(page: Page, served: tuple[Site, str]) -> None:
    site, address = served
    page.goto(address)
    press(page, "text=I agree, begin", "mouse")
    press(page, "button:has-text('Ready')", "mouse")
    page.wait_for_selector(".say strong", timeout=20_000)
    page.reload()
    page.wait_for_selector(".say strong", timeout=20_000)  # no consent, no Ready: the clock runs on
    assert page.locator(".count").inner_text() == "Practice 1 of 2"
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]


def test_an_answer_that_cannot_be_stored_is_told_and_sent_again(page: Page, served: tuple[Site, str]) -> None:
    site, address = served
    begun = time.time()
    site.study.sessions.now = lambda: begun  # no answer is late
    page.goto(address)
    press(page, "text=I agree, begin", "mouse")
    press(page, "button:has-text('Ready')", "mouse")
    page.wait_for_selector(".say strong", timeout=20_000)
    with site.store.transaction() as db:
        pass
    db.execute("PRAGMA query_only=ON")
    page.locator("text=Your answer could not be stored yet").wait_for(timeout=40_000)
    db.execute("PRAGMA query_only=OFF")
    press(page, "button:has-text('Try again')", "mouse")
    page.locator("text=the large circles show").wait_for()
    assert site.rows("SELECT late FROM answers WHERE answered_at IS NOT NULL") == [(0,)]


@pytest.mark.parametrize("how", ["no connection", "no JSON"])
def test_a_server_that_is_away_is_told(page: Page, served: tuple[Site, str], how: str) -> None:
    _, address = served
    page.goto(address)
    page.locator("text=I agree, begin").wait_for()
    page.route(
        "**/api/*", lambda route: route.abort() if how == "no connection" else route.fulfill(status=502, body="<")
    )
    press(page, "text=I agree, begin", "mouse")
    page.locator("body.offline").wait_for()
    page.locator("text=The server does not answer. Please load this page again").wait_for(timeout=40_000)
    assert page.locator("body.offline").count() == 0
    page.unroute("**/api/*")
    page.reload()
    page.locator("text=I agree, begin").wait_for()


def test_a_lost_answer_to_consent_begins_nobody_twice(page: Page, served: tuple[Site, str]) -> None:
    site, address = served
    lost = []

    def lose(route: Route) -> None:
        route.fetch()
        lost.append(route)
        route.abort()

    page.route("**/api/consent", lose, times=1)
    page.goto(f"{address}/?participant=somebody")
    press(page, "text=I agree, begin", "mouse")
    page.locator("button:has-text('Ready')").wait_for()
    assert len(lost) == 1
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]


def test_the_next_person_at_a_browser_begins_anew(page: Page, served: tuple[Site, str]) -> None:
    site, address = served
    for count, person in enumerate(("first", "second"), start=1):
        page.goto(f"{address}/?participant={person}")
        press(page, "text=I agree, begin", "mouse")
        page.locator("button:has-text('Ready')").wait_for()
        assert site.rows("SELECT count(*) FROM participants") == [(count,)]


REFUSED_ONCE = """
const play = HTMLMediaElement.prototype.play;
let first = true;
HTMLMediaElement.prototype.play = function () {
  if (!first) return play.call(this);
  first = false;
  return Promise.reject(new DOMException("", NAME));
};
"""


@pytest.mark.parametrize(
    ("name", "said", "choice"),
    [("NotAllowedError", "Press Play to watch", "Play"), ("NotSupportedError", "cannot play the clip", "Try again")],
)
def test_a_browser_that_does_not_play_at_once_is_told_so(
    page: Page, served: tuple[Site, str], tmp_path: Path, name: str, said: str, choice: str
) -> None:
    _, address = served
    page.add_init_script(REFUSED_ONCE.replace("NAME", repr(name)))
    page.goto(address)
    press(page, "text=I agree, begin", "mouse")
    for _ in range(2):  # one of the first two tasks has a clip
        press(page, "button:has-text('Ready')", "mouse")
        page.locator(f"text={said}").or_(page.locator(".say strong")).wait_for()
        if page.locator(f"text={said}").count():
            break
        place_all(page, "mouse", tmp_path)
        press(page, "button:has-text('Continue')", "mouse")
    page.screenshot(path=tmp_path / "refused.png")
    press(page, f"button:has-text('{choice}')", "mouse")
    page.wait_for_selector(".say strong", timeout=20_000)
    assert page.locator("button:has-text('Done')").is_disabled()
