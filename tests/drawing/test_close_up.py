"""Frames that are cropped to what moves."""

from typing import Any

import numpy as np

from cophy.dataset.spec import DatasetSpec
from cophy.drawing.overview import render_twins
from cophy.drawing.sheets import CloseUp, render_sequence, window_of
from cophy.scenario.rendering import MODALITIES, NO_OBJECT, Backend, Renderer, RenderSettings

RENDER = RenderSettings(list(MODALITIES), 96, Backend.tiny)


def test_nothing_of_an_object_is_cut_off_and_the_picture_is_filled(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    with Renderer(spec.scenario, RENDER.resolution) as renderer:
        whole = np.concatenate(
            [render_sequence(renderer, arrays, 2, sequence, slice(None)).segmentation for sequence in (0, 1)]
        )
    window = window_of(spec.scenario, arrays, [2])
    kept = window.cut(whole)
    assert kept.shape[1] == kept.shape[2] <= RENDER.resolution
    assert (kept != NO_OBJECT).sum() == (whole != NO_OBJECT).sum()
    seen = (kept != NO_OBJECT).any(axis=0)
    extent = max(np.ptp(np.flatnonzero(seen.any(axis=axis))) for axis in (0, 1))
    assert extent > 0.6 * kept.shape[1]


def test_a_close_up_has_about_as_many_pixels_as_the_whole(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    for frames in CloseUp(spec.scenario, arrays, [2], RENDER).frames(2, [0, -1]):
        assert frames.rgb.shape[0] == 2
        assert 0.5 * RENDER.resolution < frames.rgb.shape[1] <= 1.1 * RENDER.resolution
        assert frames.rgb.shape[:3] == frames.depth.shape == frames.segmentation.shape


def test_twins_share_a_and_c_and_nothing_later(tiny: tuple[DatasetSpec, dict[str, Any]]) -> None:
    spec, arrays = tiny
    first, second = render_twins(spec.scenario, arrays, RENDER, 5)
    for sequence in (0, 1):
        np.testing.assert_array_equal(first[sequence, 0], second[sequence, 0])
        assert (first[sequence, -1] != second[sequence, -1]).any()
    assert (first[0, 0] != first[1, 0]).any()  # C is not A
