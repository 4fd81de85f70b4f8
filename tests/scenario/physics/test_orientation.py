"""A body's own axes, against scipy's rotations."""

import numpy as np
from scipy.spatial.transform import Rotation

from cophy.scenario.physics import x_axis, z_axis


def test_axes_are_those_of_the_rotation() -> None:
    rotations = Rotation.random(50, rng=np.random.default_rng(0))
    quaternions = rotations.as_quat()
    np.testing.assert_allclose(x_axis(quaternions), rotations.apply((1.0, 0.0, 0.0)), atol=1e-12)
    np.testing.assert_allclose(z_axis(quaternions), rotations.apply((0.0, 0.0, 1.0)), atol=1e-12)


def test_what_is_no_rotation_raises_nothing() -> None:
    assert np.isfinite(z_axis(np.zeros((2, 4)))).all()
    assert np.isnan(x_axis(np.full((2, 4), np.nan))).all()
