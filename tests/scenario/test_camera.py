"""The projection against PyBullet's own pictures."""

import numpy as np
import pybullet
import pytest

from tests.conftest import SCENARIOS

RESOLUTION = 448


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_point_appears_where_pybullet_draws_a_small_ball(name: str, scenario_of) -> None:
    camera = scenario_of(name).camera
    points = np.random.default_rng(0).uniform([-1.5, -1.5, 0.2], [1.5, 1.5, 2.5], (6, 3))
    client = pybullet.connect(pybullet.DIRECT)
    try:
        shape = pybullet.createVisualShape(pybullet.GEOM_SPHERE, radius=0.15, physicsClientId=client)
        for point in points:
            pybullet.createMultiBody(baseVisualShapeIndex=shape, basePosition=point, physicsClientId=client)
        _, _, _, _, segmentation = pybullet.getCameraImage(
            RESOLUTION,
            RESOLUTION,
            pybullet.computeViewMatrix(camera.eye, camera.target, [0, 0, 1]),
            pybullet.computeProjectionMatrixFOV(camera.field_of_view_deg, 1.0, 0.1, 100.0),
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=client,
        )
    finally:
        pybullet.disconnect(client)
    bodies = np.asarray(segmentation).reshape(RESOLUTION, RESOLUTION)
    compared = 0
    for body, expected in enumerate(camera.project(points, RESOLUTION)):
        rows, columns = np.nonzero(bodies == body)
        if np.ptp(rows) + np.ptp(columns) < 1.6 * max(np.ptp(rows), np.ptp(columns)):
            continue  # another ball hides a part of it
        centre = np.array([columns.mean(), rows.mean()]) + 0.5  # pixel 0 covers 0 to 1
        assert np.linalg.norm(centre - expected) < 1.0
        compared += 1
    assert compared >= 4


def test_a_point_behind_the_camera_is_far_off_but_finite(scenario_of) -> None:
    camera = scenario_of("balls").camera
    behind = 2 * np.array(camera.eye) - camera.target + 1.0
    assert np.isfinite(camera.project(behind, RESOLUTION)).all()
