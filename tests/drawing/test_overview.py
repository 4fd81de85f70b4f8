"""Descriptions of experiments, against their arrays, and images of twins."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.drawing.overview import Descriptions, render_twins
from cophy.scenario.rendering import Backend, RenderSettings
from tests.conftest import tiny_spec

DIRECTIONS = {
    "right": (0, 1),
    "left": (0, -1),
    "back": (1, 1),
    "front": (1, -1),
}  # axis and sign: all cameras look along y


def test_a_do_operation_is_described_with_its_displacement(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    descriptions = Descriptions(spec.scenario, arrays)
    for row in range(0, len(arrays["states"]), 2):
        text, slot = descriptions.do_operation(row), arrays["do_slot"][row]
        assert text.startswith(f"the {list(spec.scenario.colors)[slot]} ")
        assert text == descriptions.do_operation(row + 1)  # of the twin
        if not arrays["presence"][row, 1, slot]:
            assert text.endswith("removed")
            continue
        moved = np.zeros(3)
        for size, direction in re.findall(r"([\d.]+)\xa0m to the (\w+)", text):
            axis, sign = DIRECTIONS[direction]
            moved[axis] = sign * float(size)
        start = arrays["states"][row, :, 0, slot, :3]
        np.testing.assert_allclose(moved, start[1] - start[0], atol=0.006)


def test_every_object_has_a_line_and_twins_differ_in_some(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    descriptions = Descriptions(spec.scenario, arrays)
    for row in (0, 1, 10):
        lines = descriptions.confounders(row)
        with_gravity = spec.scenario.name == "blocktower"
        assert len(lines) == spec.num_objects + with_gravity
        assert ("gravity" in lines[-1].text) == with_gravity
        for slot, line in zip(descriptions.slots(row), lines, strict=False):
            assert f"{arrays['mass'][row, slot]:g}\xa0kg" in line.text
            assert line.swatch == list(spec.scenario.colors.values())[slot]
    differing = descriptions.differing(4, 5)
    bold = [line.text for line in descriptions.confounders(4, bold=differing) if line.bold]
    assert 1 <= len(bold) <= len(descriptions.confounders(4))
    assert not {line.text for line in descriptions.confounders(5)} & set(bold)


def test_a_tower_is_described_from_the_top(tiny_data: Path) -> None:
    spec = tiny_spec("blocktower")
    arrays = States(spec, tiny_data).load()
    heights = arrays["states"][0, 0, 0, Descriptions(spec.scenario, arrays).slots(0), 2]
    assert (np.diff(heights) < 0).all()


def test_images_of_twins_agree_in_a_and_c_only(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    first, second = render_twins(spec.scenario, arrays, RenderSettings(["rgb"], 96, Backend.tiny), (4, 5))
    for sequence in (0, 1):
        np.testing.assert_array_equal(first[sequence, 0], second[sequence, 0])
        assert (first[sequence, -1] != second[sequence, -1]).any()
    assert (first[0, 0] != first[1, 0]).any()  # C is not A
