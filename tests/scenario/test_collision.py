from collections.abc import Iterator

import numpy as np
import pytest

from cophy.scenario import Collision, Scene, Shape
from cophy.scenario.experiment import Displace
from cophy.scenario.physics import z_axis


@pytest.fixture
def scenario(scenario_of) -> Collision:
    return scenario_of("collision")


def scenes(scenario: Collision, count: int = 200) -> Iterator[tuple[int, Scene]]:
    """Random A of all cells in turn, with their cells."""
    rng = np.random.default_rng(0)
    for index in range(count):
        cell = index % len(scenario.cells())
        yield cell, scenario.sample_scene(cell, (2, 0), rng)


def displaced(scenario: Collision, scene: Scene, kind: str, rng: np.random.Generator) -> tuple[Displace, np.ndarray]:
    """A random do-operation, and from the moving to the static object in C, horizontally."""
    do_operation = scenario.sample_do_operation(kind, scene, rng)
    assert isinstance(do_operation, Displace)
    moving, static = (np.array(body.position[:2]) for body in do_operation.apply(scene).objects)
    return do_operation, static - moving


def test_a_cell_is_named_by_its_shapes() -> None:
    assert Collision.cells() == ("sphere_sphere", "sphere_cylinder", "cylinder_sphere", "cylinder_cylinder")


def test_the_moving_object_passes_the_static_one_within_the_offset_on_either_side_with_the_one_speed(
    scenario: Collision,
) -> None:
    offsets = []
    for _, scene in scenes(scenario):
        moving, static = scene.objects
        heading = np.array(moving.linear_velocity) / scenario.speed
        between = np.subtract(static.position, moving.position)
        assert np.linalg.norm(heading) == pytest.approx(1)
        assert heading @ between > 0
        offsets.append(heading[0] * between[1] - heading[1] * between[0])
        assert static.linear_velocity == (0.0, 0.0, 0.0)
    assert np.abs(offsets).max() <= scenario.max_aim_offset
    assert np.abs(offsets).max() > 0.8 * scenario.max_aim_offset
    assert abs(np.mean(np.sign(offsets))) < 4 / np.sqrt(len(offsets))


def test_what_is_hit_has_the_origin_ahead(scenario: Collision) -> None:
    for _, scene in scenes(scenario):
        moving, static = (np.array(body.position[:2]) for body in scene.objects)
        heading = (static - moving) / np.linalg.norm(static - moving)
        np.testing.assert_allclose(static, -scenario.static_distance * heading, atol=1e-9)
        assert scenario.distance[0] <= np.linalg.norm(static - moving) <= scenario.distance[1]


def test_headings_are_as_likely_after_every_symmetry(scenario: Collision) -> None:
    """By the eight sectors that a square's symmetries exchange."""
    velocity = np.array([scene.objects[0].linear_velocity[:2] for _, scene in scenes(scenario, 1600)])
    sector = np.floor((np.arctan2(velocity[:, 1], velocity[:, 0]) + np.pi) / (np.pi / 4)).astype(int) % 8
    assert len(scenario.symmetries()) == 8
    assert np.abs(np.bincount(sector, minlength=8) - 200).max() < 60  # 4.5 standard deviations


def test_what_moves_slides_upright_and_static_cylinders_stand_or_lie_any_way(scenario: Collision) -> None:
    axes = []
    for cell, scene in scenes(scenario, 400):
        moving, static = scene.objects
        assert moving.quaternion_xyzw == (0.0, 0.0, 0.0, 1.0)
        assert moving.position[2] == static.position[2] == scenario.object_size / 2
        if scenario.shapes_of_cell(cell)[1] is Shape.CYLINDER:
            axes.append(z_axis(np.array(static.quaternion_xyzw)))
        else:
            assert static.quaternion_xyzw == (0.0, 0.0, 0.0, 1.0)
    up = np.abs(np.array(axes)[:, 2])
    stands, lies = np.isclose(up, 1), np.isclose(up, 0, atol=1e-9)
    assert (stands | lies).all()
    assert 0.35 < stands.mean() < 0.65
    direction = np.array(axes)[lies]
    assert np.linalg.eigvalsh(direction[:, :2].T @ direction[:, :2] / len(direction)).min() > 0.3  # ½ where isotropic


@pytest.mark.parametrize("kind", Collision.known_do_operations())
def test_a_do_operation_moves_the_object_it_names_along_an_axis_and_touches_nothing(
    kind: str, scenario: Collision
) -> None:
    rng = np.random.default_rng(1)
    for _, scene in scenes(scenario):
        do_operation, between = displaced(scenario, scene, kind, rng)
        moved = dict(zip(Collision.known_do_operations(), scene.objects, strict=True))[kind]
        assert do_operation.slot == moved.slot
        assert sorted(offset != 0 for offset in do_operation.offset_m) == [False, False, True]
        assert scenario.displacement[0] <= np.abs(do_operation.offset_m).max() <= scenario.displacement[1]
        # a lying cylinder reaches √½ of its size, the other object half of its own
        assert np.linalg.norm(between) >= (0.5 + np.sqrt(0.5)) * scenario.object_size + scenario.min_gap


def test_objects_slide_on_a_floor_of_the_friction_that_is_configured(scenario: Collision) -> None:
    _, scene = next(scenes(scenario))
    floor = scene.bodies[0]
    assert (floor.slot, floor.friction) == (None, scenario.floor_friction)
    assert floor == scenario.floor()
