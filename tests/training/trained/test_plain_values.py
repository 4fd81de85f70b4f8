"""What a checkpoint says of itself is plain, whoever wrote it."""

import math
from typing import Any

import pytest

from cophy.training.checkpoints import MAX_VALUES, check_plain


def inside_itself() -> dict[str, Any]:
    tree: dict[str, Any] = {}
    tree["inner"] = tree
    return tree


def nested(depth: int) -> list[Any]:
    tree: list[Any] = []
    for _ in range(depth):
        tree = [tree]
    return tree


def doubled(times: int) -> list[Any]:
    """A few lists in memory, but 2 to the power of `times` when each is visited."""
    tree: list[Any] = [1]
    for _ in range(times):
        tree = [tree, tree]
    return tree


def test_a_configuration_is_plain() -> None:
    check_plain({"a": {"b": [1, 2.5, True, None, "#00ff00"], "c": {}}, "d": [], "e": -(2**63) + 1})


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (inside_itself(), "nested more than 10 deep, or contain themselves"),
        (nested(5000), "nested more than 10 deep"),
        ([doubled(8)] * 1000, "more than 100,000 values"),
        ([None] * (MAX_VALUES + 1), "more than 100,000 values"),
        ({1: 2}, "a key of int is no name"),
        ((1, 2), "a tuple is no value of a configuration"),
        ([math.nan], "nan is no finite number"),
        ([2**63], "a number of 64 bits is too large"),
        (["a" * 5000], "a text of 5000 characters is too long"),
        (["\x1b[2J"], "not all of them can be printed"),
        (["${oc.env:HOME}"], "is a reference"),
        ({"${oc.env:HOME}": 1}, "is a reference"),
    ],
)
def test_what_no_configuration_holds_is_refused(tree: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_plain([tree])
