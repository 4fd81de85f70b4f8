"""What follows from stored states, worked out by hand."""

import numpy as np

from cophy.dataset.features import further_than_twin, stable_frames, stands, visible_axis
from cophy.scenario import Shape

UPRIGHT = [0.0, 0.0, 0.0, 1.0]
QUARTER = np.sqrt(0.5)


def test_axes_are_those_that_pictures_show() -> None:
    turned_left, laid_along_minus_x = [0.0, 0.0, QUARTER, QUARTER], [0.0, -QUARTER, 0.0, QUARTER]
    quaternions = np.array([[UPRIGHT, turned_left, laid_along_minus_x, UPRIGHT, [0.0] * 4]])
    shapes = np.array([[Shape.CYLINDER, Shape.BOX, Shape.CYLINDER, Shape.SPHERE, 0]])
    expected = [[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, 0], [0, 0, 0]]
    np.testing.assert_allclose(visible_axis(quaternions, shapes), [expected], atol=1e-12)


def test_an_object_is_stable_in_a_frame_if_it_was_slow_since_the_frame_before() -> None:
    states = np.zeros((1, 9, 1, 13))
    states[0, [0, 5], 0, 8] = 2.0  # fast in the first state, which counts for no frame, and between frames 1 and 2
    assert stable_frames(states, stride=3, stable_speed=1.0).shape == (1, 2, 1)
    assert stable_frames(states, stride=3, stable_speed=1.0)[0, :, 0].tolist() == [True, False]


def two_twins(moved_m: float) -> dict[str, np.ndarray]:
    """Of one object, which moves in the second twin's CD alone."""
    states = np.zeros((2, 2, 3, 1, 13))
    states[1, 1, 1:, 0, 0] = moved_m
    return {"states": states, "presence": np.ones((2, 2, 1), dtype=bool), "twin": np.array([0, 0])}


def test_a_tower_stands_while_no_block_leaves_its_place() -> None:
    assert stands(two_twins(0.09), fallen_distance=0.1).tolist() == [[True, True], [True, True]]
    assert stands(two_twins(0.11), fallen_distance=0.1).tolist() == [[True, True], [True, False]]


def test_objects_go_further_than_under_the_confounders_of_the_twin() -> None:
    assert further_than_twin(two_twins(1.0)).tolist() == [[False, False], [False, True]]
