"""A real browser takes the study, from consent to the code."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests.study.browser.steps import all_in_sight, begin, place_all, press
from tests.study.conftest import Site

CASES = [("desktop", "mouse"), ("desktop", "keyboard"), ("phone", "touch"), ("phone", "keyboard")]
START = 224  # where the cross of the keyboard begins: the middle of the picture
pytestmark = pytest.mark.slow


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
    begin(page, address)
    page.locator(".board").click(position={"x": 100, "y": 100})
    page.locator("text=the large circles show").wait_for(timeout=15_000)
    present = len(site.study.experiments.scenes.slots(site.study.experiments.practice[0].experiment))
    assert site.rows("SELECT late FROM answers WHERE answered_at IS NOT NULL") == [(0,)]
    assert site.rows("SELECT count(*), sum(x IS NULL) FROM clicks") == [(present, present - 1)]


def test_a_browser_that_comes_back_goes_on(page: Page, served: tuple[Site, str]) -> None:
    site, address = served
    begin(page, address)
    page.reload()
    page.wait_for_selector(".say strong", timeout=20_000)  # no consent, no Ready: the clock runs on
    assert page.locator(".count").inner_text() == "Practice 1 of 2"
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]


def test_the_next_person_at_a_browser_begins_anew(page: Page, served: tuple[Site, str]) -> None:
    site, address = served
    for count, person in enumerate(("first", "second"), start=1):
        page.goto(f"{address}/?participant={person}")
        press(page, "text=I agree, begin", "mouse")
        page.locator("button:has-text('Ready')").wait_for()
        assert site.rows("SELECT count(*) FROM participants") == [(count,)]
