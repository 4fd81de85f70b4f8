"""What a person does in the window."""

import time
from pathlib import Path

from playwright.sync_api import Page


def press(page: Page, selector: str, by: str) -> None:
    """Press a button as a person would: by mouse, touch or keyboard."""
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


def begin(page: Page, address: str) -> None:
    """Agree, and watch the first task until objects can be placed."""
    page.goto(address)
    press(page, "text=I agree, begin", "mouse")
    press(page, "button:has-text('Ready')", "mouse")
    page.wait_for_selector(".say strong", timeout=20_000)


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
