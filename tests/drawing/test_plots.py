"""Figures of predictions."""

import numpy as np

from cophy.drawing.plots import draw_error_over_time, draw_trajectories


def test_twins_share_axis_limits() -> None:
    rng = np.random.default_rng(0)
    initial = rng.normal(size=(3, 2, 3))
    initial[1] = initial[0]  # twins
    true = initial[:, None] + np.array([1.0, 5.0, 2.0])[:, None, None, None] * rng.normal(size=(3, 4, 2, 3))
    figure = draw_trajectories(initial, true, true, np.ones((3, 2), bool), colors=["red", "blue"])
    for row in np.array(figure.axes).reshape(2, 3):
        limits = [(*axis.get_xlim(), *axis.get_ylim()) for axis in row]
        assert limits[0] == limits[1]
        assert limits[0] != limits[2]


def test_objects_that_stay_at_their_height_are_drawn_from_above_only() -> None:
    initial = np.random.default_rng(0).normal(size=(2, 2, 3))
    true = initial[:, None] + np.array([1.0, 1.0, 0.0]) * np.arange(4)[:, None, None]
    assert len(draw_trajectories(initial, true, true, np.ones((2, 2), bool), colors=["red", "blue"]).axes) == 2


def test_bands_are_drawn_where_they_are_known() -> None:
    curves = {name: np.ones(3) for name in ("a", "b")}
    figure = draw_error_over_time(
        curves, frame_rate_hz=5.0, half_widths={"a": np.full(3, 0.1), "b": np.full(3, np.nan)}
    )
    assert len(figure.axes[0].collections) == 1
    assert figure.legends[0].get_texts()[-1].get_text() == "95 % interval\nover clusters"


def test_title_and_legend_of_trajectories_touch_nothing() -> None:
    initial = np.random.default_rng(0).normal(size=(2, 2, 3))
    true = initial[:, None] + np.array([1.0, 1.0, 0.0]) * np.arange(4)[:, None, None]
    title, headings = "CoPhyNet, seed 0\ncollision, all\nsize tiny", ["twin 1", "twin 2"]
    figure = draw_trajectories(
        initial, true, true, np.ones((2, 2), bool), colors=["red", "blue"], title=title, headings=headings
    )
    figure.draw_without_rendering()
    axis, point = figure.axes[0], figure.dpi / 72
    suptitle, legend = figure.texts[0].get_window_extent(), figure.legends[0].get_window_extent()
    assert suptitle.y0 - axis.title.get_window_extent().y1 > 5 * point
    assert axis.xaxis.label.get_window_extent().y0 - legend.y1 > 5 * point


def test_a_long_legend_fits_into_the_figure() -> None:
    curves = {f"method {n} with a name that needs several lines": np.full(3, float(n)) for n in range(14)}
    figure = draw_error_over_time(curves, frame_rate_hz=5.0)
    figure.draw_without_rendering()
    legend = figure.legends[0].get_window_extent()
    assert legend.y0 >= 0
    assert legend.y1 <= figure.bbox.y1
