"""How hypothesis attacks here."""

from collections.abc import Callable
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st


def often(count: int, attack: Callable[[Any], None]) -> None:
    """Call `attack` so often with a function that draws from a strategy; the draws are the same each time.

    Nothing is made smaller where it fails: that would take longer than to look at it.
    """
    once = settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    once(given(st.data())(lambda data: attack(data.draw)))()
