"""What a person says of one experiment, checked before anything is stored."""

import math
from dataclasses import dataclass
from typing import Any

INPUTS = ("mouse", "touch", "keyboard", "pen", "none")
MAX_UNDONE = 1000
MAX_WINDOW_PX = 20_000


class BadAnswerError(ValueError):
    """What a browser sent is no answer."""


@dataclass(frozen=True)
class Click:
    """Where a person says that an object ends: pixels of the picture; at_ms after the clock began."""

    x: float
    y: float
    at_ms: int


@dataclass(frozen=True)
class Answer:
    """Of one assignment.

    clicks: by slot; a slot that was not clicked is absent. undone: clicks that were taken back. names_shown: whether the
    person let the names be written on the objects. input: of the last click. window: width and height, CSS pixels.
    """

    clicks: dict[int, Click]
    undone: int
    names_shown: bool
    input: str
    window: tuple[int, int]


def parse(body: Any, *, slots: set[int], resolution: int, last_ms: int) -> Answer:
    """The answer in what a browser sent.

    Args:
        body: Decoded JSON.
        slots: Of the objects in C.
        resolution: Of the picture; clicks have to be inside.
        last_ms: When the last click may be.

    Raises:
        BadAnswerError: It is none.
    """
    if not isinstance(body, dict) or set(body) != {"clicks", "undone", "names_shown", "input", "window"}:
        raise BadAnswerError("not the fields of an answer")
    if not isinstance(body["clicks"], list) or len(body["clicks"]) > len(slots):
        raise BadAnswerError("clicks: at most one per object")
    clicks = dict(_click(each, slots, resolution, last_ms) for each in body["clicks"])
    if len(clicks) != len(body["clicks"]):
        raise BadAnswerError("clicks: two for one object")
    if not isinstance(body["names_shown"], bool) or body["input"] not in INPUTS:
        raise BadAnswerError("names_shown or input")
    window = body["window"]
    if not isinstance(window, list) or len(window) != 2:
        raise BadAnswerError("window: width and height")
    width, height = (int(_number(side, 1, MAX_WINDOW_PX, whole=True)) for side in window)
    undone = int(_number(body["undone"], 0, MAX_UNDONE, whole=True))
    return Answer(clicks, undone, body["names_shown"], body["input"], (width, height))


def _click(body: Any, slots: set[int], resolution: int, last_ms: int) -> tuple[int, Click]:
    if not isinstance(body, dict) or set(body) != {"slot", "x", "y", "at_ms"}:
        raise BadAnswerError("not the fields of a click")
    slot = int(_number(body["slot"], 0, 1000, whole=True))
    if slot not in slots:
        raise BadAnswerError("slot: no such object in this picture")
    x, y = (_number(body[axis], 0, resolution) for axis in "xy")
    return slot, Click(x, y, int(_number(body["at_ms"], 0, last_ms, whole=True)))


def _number(value: Any, smallest: float, largest: float, *, whole: bool = False) -> float:
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
        raise BadAnswerError("not a number")
    if not smallest <= value <= largest or not math.isfinite(value):
        raise BadAnswerError("a number out of its range")
    return float(value)
