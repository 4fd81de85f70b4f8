"""What a checkpoint says of itself: the plain values of a configuration, and not too many."""

import math
from typing import Any

# ours: an origin has some 200 values, 4 levels deep, and no text that is longer than a path
MAX_VALUES, MAX_DEPTH, MAX_TEXT = 100_000, 10, 4096
MAX_BITS = 63


def check_plain(tree: Any) -> None:
    """Refuse what no configuration holds, such as other types, references, and what contains itself.

    Raises:
        ValueError: There is such a value; the message says which.
    """
    level = [tree]
    for _ in range(MAX_DEPTH):
        inner: list[Any] = []
        for value in level:
            inside = _inside(value)
            if len(inner) + len(inside) > MAX_VALUES:
                raise ValueError(f"it says more than {MAX_VALUES:,} values of itself")
            inner += inside
        if not inner:
            return
        level = inner
    raise ValueError(f"it says values of itself that are nested more than {MAX_DEPTH} deep, or contain themselves")


def _inside(value: Any) -> list[Any]:
    """What a value holds; only dictionaries and lists hold others."""
    if isinstance(value, dict):
        if odd := [key for key in value if not isinstance(key, str)]:
            raise ValueError(f"a key of {type(odd[0]).__name__} is no name")
        return [*value, *value.values()]
    if isinstance(value, list):
        return value
    if isinstance(value, str):
        _check_text(value)
    elif value is not None and not isinstance(value, bool | int | float):
        raise ValueError(f"a {type(value).__name__} is no value of a configuration")
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is no finite number")
    elif isinstance(value, int) and value.bit_length() > MAX_BITS:
        raise ValueError(f"a number of {value.bit_length()} bits is too large")
    return []


def _check_text(text: str) -> None:
    if len(text) > MAX_TEXT or not text.isprintable():
        raise ValueError(f"a text of {len(text)} characters is too long, or not all of them can be printed")
    if "${" in text:  # OmegaConf would resolve it: to other keys, and to what the environment holds
        raise ValueError(f"{text} is a reference, whose value it has to say instead")
