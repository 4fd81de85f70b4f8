"""Experiments in words, against their arrays."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.drawing.labels import Words
from tests.conftest import tiny_spec

WAYS = {"right": (0, 1), "left": (0, -1), "back": (1, 1), "front": (1, -1)}  # axis and sign: all cameras look along y


def test_a_do_operation_says_whether_and_how_far_its_object_moves(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    words = Words(spec.scenario, arrays)
    for row in range(0, len(arrays["states"]), 2):
        said, slot = words.do_operation(row), arrays["do_slot"][row]
        assert said.startswith(f"the {list(spec.scenario.colors)[slot]} ")
        assert said == words.do_operation(row + 1)  # of the twin
        if not arrays["presence"][row, 1, slot]:
            assert said.endswith("taken away")
            continue
        moved = np.zeros(3)
        for size, way in re.findall(r"([\d.]+)\xa0m to the (\w+)", said):
            axis, sign = WAYS[way]
            moved[axis] = sign * float(size)
        start = arrays["states"][row, :, 0, slot, :3]
        np.testing.assert_allclose(moved, start[1] - start[0], atol=0.006)


def test_every_object_has_its_line_and_twins_differ_in_some(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    words = Words(spec.scenario, arrays)
    for row in (0, 1, 10):
        lines = words.confounders(row)
        with_gravity = spec.scenario.name == "blocktower"
        assert len(lines) == spec.num_objects + with_gravity
        assert ("gravity" in lines[-1].text) == with_gravity
        for slot, line in zip(words.slots(row), lines, strict=False):
            assert f"{arrays['mass'][row, slot]:g}\xa0kg" in line.text
            assert line.swatch == list(spec.scenario.colors.values())[slot]
    differing = words.differing(4, 5)
    bold = [line.text for line in words.confounders(4, bold=differing) if line.bold]
    assert 1 <= len(bold) <= len(words.confounders(4))
    assert not {line.text for line in words.confounders(5)} & set(bold)


def test_a_tower_is_named_from_the_top(tiny_data: Path) -> None:
    spec = tiny_spec("blocktower")
    arrays = States(spec, tiny_data).load()
    heights = arrays["states"][0, 0, 0, Words(spec.scenario, arrays).slots(0), 2]
    assert (np.diff(heights) < 0).all()
