"""Any value of any key is accepted or refused in one line."""

import sys
from collections.abc import Iterator
from functools import cache
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import note
from hypothesis import strategies as st
from omegaconf import DictConfig

from cophy import cli
from cophy.config import composed, to_config, to_plain
from tests.attacks.often import often

COMMANDS = (
    *((name, "scenario=balls") for name in ("generate", "audit", "look", "export", "derender", "train")),
    *(
        ("train", f"model={model}")
        for model in ("alongside", "copy_b", "derenderer", "in", "npe", "oracle_feedforward")
    ),
    ("train", "source=cophy"),
    ("predict",),
    ("report",),
    ("study",),
)
STRANGE = (
    *("foo", "''", "[]", "{}", "null", "nan", "-inf", "-1", "0", "0.5", "1e400", "1e-320", "9" * 20, "true", "[1,2]"),
    *("[[]]", "[null]", "[nan]", "{a: 1}", "../x", "é", "a" * 300, "${nope}", "${data_dir}", "${oc.env:NOPE}", "???"),
)  # fmt: skip
LONGEST = 900  # of a line that says what is wrong


@cache
def keys_of(command: tuple[str, ...]) -> list[str]:
    return list(_keys(composed(*command), ""))


def _keys(node: DictConfig, path: str) -> Iterator[str]:
    for key in map(str, node):
        yield f"{path}{key}"
        inner = node._get_node(key)
        if isinstance(inner, DictConfig) and not inner._is_missing() and not inner._is_none():
            yield from _keys(inner, f"{path}{key}.")


def attack(draw: Any) -> None:
    command = draw(st.sampled_from(COMMANDS))
    key = draw(st.sampled_from(keys_of(command)))
    value = draw(
        st.one_of(st.sampled_from(STRANGE), st.integers().map(str), st.floats().map(str), st.text(max_size=20))
    )
    note(f"{command} {key}={value}")
    try:
        found = composed(*command, f"{key}={value}")
        to_config(found, object)
        to_plain(found)
    except Exception as error:
        if not cli.is_mendable(error):
            raise
        with patch.object(sys, "argv", ["src/command.py", *command[1:], f"{key}={value}"]):
            said = cli.explain(error)
        assert "\n" not in said
        assert len(said) < LONGEST + 2 * len(value)


def test_a_strange_value_is_accepted_or_refused_in_one_line() -> None:
    often(50, attack)


@pytest.mark.slow
def test_many_strange_values_are_accepted_or_refused_in_one_line(attacks: int) -> None:
    often(300 * attacks, attack)
