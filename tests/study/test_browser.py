"""Debian's Chromium (package chromium), driven by Playwright, takes the study."""

import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("playwright", reason="not installed: just test-slow installs it")
from playwright.sync_api import Page, Route, ViewportSize, sync_playwright

from cophy.config import settings
from cophy.dataset.states import States
from cophy.study.answers import PERSON, AnswerStore
from cophy.study.experiments import StudyExperiments
from cophy.study.sessions import Sessions
from tests.conftest import tiny_spec
from tests.study.conftest import SMALL, Site, serving

CHROMIUM = shutil.which("chromium")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's package chromium")]
DESKTOP, PHONE = ViewportSize(width=1280, height=800), ViewportSize(width=360, height=640)
CENTER = 224  # of the image, where the cross of the keyboard starts
PLACING = ".say strong"  # is there while objects can be placed


@pytest.fixture(scope="module")
def large(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> StudyExperiments:
    """Experiments with images of 448 × 448."""
    states, large = States(tiny_spec("blocktower"), tiny_data), replace(SMALL, resolution=448, seconds=6)
    study = StudyExperiments(states, settings("study").split, large, tmp_path_factory.mktemp("study"))
    study.draw_missing(workers=2)
    return study


@pytest.fixture
def served(large: StudyExperiments, tmp_path: Path) -> Iterator[tuple[Site, str]]:
    """A study and its URL."""
    path = tmp_path / "answers.sqlite"
    store = AnswerStore(path)
    site = Site(Sessions(store, large, PERSON), path, clock=time.time)  # type: ignore[arg-type]
    with serving(site) as (host, port):
        yield site, f"http://{host}:{port}"
    store.close()


@pytest.fixture
def page(request: pytest.FixtureRequest) -> Iterator[Page]:
    """A window, of a desktop or of a phone; errors of the page fail the test."""
    is_phone = getattr(request, "param", "desktop") == "phone"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(viewport=PHONE if is_phone else DESKTOP, has_touch=is_phone, is_mobile=is_phone)
        page = context.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        yield page
        browser.close()
    assert errors == []


def press(page: Page, selector: str, device: str = "mouse") -> None:
    """Press a button with mouse, touch or keyboard."""
    button = page.locator(selector)
    button.wait_for()
    if device == "keyboard":
        for _ in range(12):
            page.keyboard.press("Tab")
            if button.evaluate("button => button === document.activeElement"):
                break
        page.keyboard.press("Enter")
    elif device == "touch":
        button.tap()
    else:
        button.click()


def begin(page: Page, url: str) -> None:
    """Agree, and watch the first task until objects can be placed."""
    page.goto(url)
    press(page, "text=I agree, begin")
    press(page, "button:has-text('Ready')")
    page.wait_for_selector(PLACING, timeout=20_000)


def place_all(page: Page, device: str, screenshots: Path) -> None:
    """Place all objects near the center next to each other, undo one click, and press Done."""
    page.locator(".buttons .undo[disabled]").wait_for()
    for number in range(page.locator(".objects li").count()):
        if device == "keyboard":
            page.keyboard.press("ArrowRight")
            page.keyboard.press("Enter")
        else:
            box = page.locator(".board").bounding_box()
            assert box is not None
            position = {"x": box["width"] / 2 + 10 * number, "y": box["height"] / 2}
            click = page.locator(".board").tap if device == "touch" else page.locator(".board").click
            click(position=position)  # type: ignore[operator]
        if number == 0:
            page.keyboard.press("Backspace") if device == "keyboard" else press(page, ".undo", device)
            assert page.locator(".objects .set").count() == 0
            page.keyboard.press("Enter") if device == "keyboard" else page.locator(".board").click(position=position)
    page.screenshot(path=screenshots / f"placed-{time.time():.0f}.png")
    page.keyboard.press("d") if device == "keyboard" else press(page, ".done", device)


def outside_of_window(page: Page) -> list[str]:
    """Return the parts of a task that are not completely visible."""
    size = page.viewport_size
    assert size is not None
    outside = []
    for name in (".say", ".frame", ".clock", ".objects", ".undo", ".label", ".done"):
        box = page.locator(name).bounding_box()
        is_high = box and box["y"] >= 0 and box["y"] + box["height"] <= size["height"] + 0.5
        if not (box and is_high and box["x"] >= 0 and box["x"] + box["width"] <= size["width"] + 0.5):
            outside.append(f"{name} {box}")
    return outside


@pytest.mark.parametrize(
    ("page", "device"), [("desktop", "mouse"), ("desktop", "keyboard"), ("phone", "touch")], indirect=["page"]
)
def test_from_consent_to_code(page: Page, device: str, served: tuple[Site, str], tmp_path: Path) -> None:
    site, url = served
    page.goto(f"{url}/?participant=somebody")
    press(page, "text=I agree, begin", device)
    for position in range(4):
        if position <= 2:
            press(page, f"button:has-text('{'Ready' if position < 2 else 'Begin'}')", device)
        page.wait_for_selector(PLACING, timeout=20_000)
        assert outside_of_window(page) == []
        place_all(page, device, tmp_path)
        if position < 2:
            page.locator("text=the large circles show").wait_for()
            page.screenshot(path=tmp_path / f"practice-{position}.png")
            press(page, "button:has-text('Continue')", device)
    code = page.locator(".code").inner_text()
    assert site.rows("SELECT code, finished_at IS NOT NULL FROM participants") == [(code, 1)]
    assert site.rows("SELECT count(*), sum(late), min(undone) FROM answers") == [(4, 0, 1)]
    assert site.rows("SELECT DISTINCT input FROM answers") == [(device,)]
    ((missing, low, high),) = site.rows("SELECT sum(x IS NULL), min(x), max(x) FROM clicks")
    assert missing == 0
    assert CENTER - 2 <= low <= high <= CENTER + 40


def test_objects_that_were_not_clicked_in_time_are_stored_as_missing(page: Page, served: tuple[Site, str]) -> None:
    site, url = served
    begin(page, url)
    page.locator(".board").click(position={"x": 100, "y": 100})
    page.locator("text=the large circles show").wait_for(timeout=15_000)
    experiments = site.sessions.experiments
    num_objects = len(experiments.scenes.slots(experiments.practice[0].experiment))
    assert site.rows("SELECT late FROM answers WHERE answered_at IS NOT NULL") == [(0,)]
    assert site.rows("SELECT count(*), sum(x IS NULL) FROM clicks") == [(num_objects, num_objects - 1)]


def test_a_participant_continues_after_loading_the_page_again(page: Page, served: tuple[Site, str]) -> None:
    site, url = served
    begin(page, url)
    page.reload()
    page.wait_for_selector(PLACING, timeout=20_000)  # no consent and no Ready: the clock has not stopped
    assert page.locator(".count").inner_text() == "Practice 1 of 2"
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]


def test_another_id_in_the_same_browser_is_another_participant(page: Page, served: tuple[Site, str]) -> None:
    site, url = served
    for count, name in enumerate(("first", "second"), start=1):
        page.goto(f"{url}/?participant={name}")
        press(page, "text=I agree, begin")
        page.locator("button:has-text('Ready')").wait_for()
        assert site.rows("SELECT count(*) FROM participants") == [(count,)]


def test_an_answer_that_could_not_be_stored_is_sent_again(page: Page, served: tuple[Site, str]) -> None:
    site, url = served
    start = time.time()
    site.sessions.now = lambda: start  # no answer is late
    begin(page, url)
    with site.sessions.store.transaction() as db:
        pass
    db.execute("PRAGMA query_only=ON")
    page.locator("text=Your answer could not be stored yet").wait_for(timeout=40_000)
    db.execute("PRAGMA query_only=OFF")
    press(page, "button:has-text('Try again')")
    page.locator("text=the large circles show").wait_for()
    assert site.rows("SELECT late FROM answers WHERE answered_at IS NOT NULL") == [(0,)]


@pytest.mark.parametrize("failure", ["no connection", "not JSON"])
def test_the_page_shows_that_the_server_does_not_answer(page: Page, served: tuple[Site, str], failure: str) -> None:
    _, url = served
    page.goto(url)
    page.locator("text=I agree, begin").wait_for()
    page.route(
        "**/api/*", lambda route: route.abort() if failure == "no connection" else route.fulfill(status=502, body="<")
    )
    press(page, "text=I agree, begin")
    page.locator("body.offline").wait_for()
    page.locator("text=The server does not answer. Please load this page again").wait_for(timeout=40_000)
    assert page.locator("body.offline").count() == 0
    page.unroute("**/api/*")
    page.reload()
    page.locator("text=I agree, begin").wait_for()


def test_a_consent_whose_response_was_lost_adds_one_participant(page: Page, served: tuple[Site, str]) -> None:
    site, url = served
    lost = []

    def lose(route: Route) -> None:
        route.fetch()
        lost.append(route)
        route.abort()

    page.route("**/api/consent", lose, times=1)
    page.goto(f"{url}/?participant=somebody")
    press(page, "text=I agree, begin")
    page.locator("button:has-text('Ready')").wait_for()
    assert len(lost) == 1
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]


REFUSE_ONCE = """
const play = HTMLMediaElement.prototype.play;
let first = true;
HTMLMediaElement.prototype.play = function () {
  if (!first) return play.call(this);
  first = false;
  return Promise.reject(new DOMException("", NAME));
};
"""


@pytest.mark.parametrize(
    ("error", "message", "button"),
    [("NotAllowedError", "Press Play to watch", "Play"), ("NotSupportedError", "cannot play the clip", "Try again")],
)
def test_a_browser_that_does_not_play_the_clip_offers_a_button(
    page: Page, served: tuple[Site, str], tmp_path: Path, error: str, message: str, button: str
) -> None:
    _, url = served
    page.add_init_script(REFUSE_ONCE.replace("NAME", repr(error)))
    page.goto(url)
    press(page, "text=I agree, begin")
    for _ in range(2):  # one of the first two tasks has a clip
        press(page, "button:has-text('Ready')")
        page.locator(f"text={message}").or_(page.locator(PLACING)).wait_for()
        if page.locator(f"text={message}").count():
            break
        place_all(page, "mouse", tmp_path)
        press(page, "button:has-text('Continue')")
    press(page, f"button:has-text('{button}')")
    page.wait_for_selector(PLACING, timeout=20_000)
    assert page.locator("button:has-text('Done')").is_disabled()
