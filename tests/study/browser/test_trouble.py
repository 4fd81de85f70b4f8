"""Lost connections, disks that cannot be written and browsers that do not play: the person is told, nothing is lost."""

import time
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route

from tests.study.browser.steps import begin, place_all, press
from tests.study.conftest import Site

pytestmark = pytest.mark.slow


def test_an_answer_that_cannot_be_stored_is_told_and_sent_again(page: Page, served: tuple[Site, str]) -> None:
    site, address = served
    begun = time.time()
    site.study.sessions.now = lambda: begun  # no answer is late
    begin(page, address)
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
