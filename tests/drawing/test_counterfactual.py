"""Predictions as images."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cophy.dataset.images import render_sequence
from cophy.dataset.spec import DatasetSpec
from cophy.drawing.counterfactual import render_positions, window_of_changes, write_counterfactual
from cophy.drawing.files import read_frames
from cophy.drawing.overview import write_frames
from cophy.errors import CophyError
from cophy.scenario.rendering import Renderer

RESOLUTION, ROW = 96, 3


def true_positions(spec: DatasetSpec, arrays: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    stride = spec.scenario.clock.states_per_frame
    return arrays["states"][ROW, 1, ::stride, :, :3], arrays["presence"][ROW, 1]


def test_true_positions_over_the_true_background_give_the_true_images(
    tiny: tuple[DatasetSpec, dict[str, Any]], tmp_path: Path
) -> None:
    """Except for what positions do not contain: rotations of blocks, and which objects are cylinders."""
    spec, arrays = tiny
    with Renderer(spec.scenario, RESOLUTION) as renderer:
        truth = render_sequence(renderer, arrays, ROW, 1, slice(None)).rgb
        (tmp_path / "AB").mkdir()
        for name in ("99.png", "notes.png"):  # from a longer sequence; by the user
            (tmp_path / "AB" / name).write_bytes(b"")
        write_frames(tmp_path, renderer, arrays, ROW)
    assert not (tmp_path / "AB" / "99.png").exists()
    (tmp_path / "AB" / "notes.png").unlink()
    background = read_frames(tmp_path / "background.png")[0]
    np.testing.assert_array_equal(read_frames(tmp_path / "CD"), truth)
    drawn = render_positions(*true_positions(spec, arrays), spec.scenario, background)
    off = np.abs(drawn.astype(int) - truth).max(axis=-1)
    assert (off > 12).mean() < (0.001 if spec.scenario.name == "balls" else 0.05)
    on_another = render_positions(*true_positions(spec, arrays), spec.scenario, np.full_like(background, 225))
    assert (np.abs(on_another.astype(int) - truth).max(axis=-1) > 12).mean() > 0.5


def test_images_are_cropped_to_what_changes() -> None:
    background = np.full((50, 50, 3), 100, np.uint8)
    frames = np.stack([background] * 2)
    frames[0, 10:14, 20:24], frames[1, 25:28, 30:34] = 200, 10
    window = window_of_changes(frames, background)
    cropped = window.cut(frames)
    assert cropped.shape[1] == cropped.shape[2] < 28
    assert (cropped != 100).sum() == (frames != 100).sum()
    assert window_of_changes(background[None], background).edge == 1.0


def test_the_strip_has_rows_for_ab_the_truth_and_the_prediction(
    tiny: tuple[DatasetSpec, dict[str, Any]], tmp_path: Path
) -> None:
    spec, arrays = tiny
    positions, presence = true_positions(spec, arrays)
    frames = np.full((len(positions), 32, 32, 3), 100, np.uint8)
    arguments = (positions, presence, spec.scenario)
    heights = []
    for name, truth in (("without", None), ("with", frames)):
        write_counterfactual(tmp_path / name, *arguments, observed=frames, truth=truth, background=None)
        heights.append(read_frames(tmp_path / name / "strip.png").shape[1])
    assert heights[1] - heights[0] == 224 + 4
    for wrong in ({"truth": frames[1:], "background": None}, {"truth": None, "background": frames[0, 1:]}):
        with pytest.raises(CophyError, match="rows and columns, AB has"):
            write_counterfactual(tmp_path, *arguments, observed=frames, **wrong)
