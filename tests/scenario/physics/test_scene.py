import numpy as np
import pytest

from cophy.scenario import Body, Scene, Shape
from cophy.scenario.physics import make_floor


def test_a_movable_body_needs_a_mass() -> None:
    with pytest.raises(ValueError, match="slot and a mass"):
        Body(Shape.BOX, (1, 1, 1), (0, 0, 0), slot=1)


def test_velocities_are_those_of_the_objects_in_their_order() -> None:
    balls = (Body(Shape.SPHERE, (1, 1, 1), (2.0 * slot, 0.0, 0.5), slot, mass=1.0) for slot in (2, 0))
    scene = Scene((make_floor(), *balls), gravity=(0.0, 0.0, -10.0))
    moving = scene.with_velocities(np.array([[1.0, 2.0], [3.0, 4.0]]))
    assert [body.linear_velocity for body in moving.objects] == [(1.0, 2.0, 0.0), (3.0, 4.0, 0.0)]
    assert moving.at_rest() == scene
