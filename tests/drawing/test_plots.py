"""Figures of predictions."""

import numpy as np

from cophy.drawing.plots import draw_trajectories


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
