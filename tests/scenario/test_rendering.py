"""Images of scenes: colours, depth, segmentation, textures."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.spec import DatasetSpec
from cophy.errors import CophyError
from cophy.scenario import Camera, Scenario, Shape
from cophy.scenario.rendering import NO_OBJECT, Backend, Frames, Renderer, RenderSettings, backdrop_image, floor_texture
from tests.conftest import FLOOR_PX, floors_of

RESOLUTION = 224


def draw(scenario: Scenario, shape: Shape, position: tuple[float, ...], yaw: float = 0.0, seed: int = 1) -> Frames:
    """One object, in slot 1."""
    positions, quaternions = np.zeros((1, scenario.num_slots, 3)), np.zeros((1, scenario.num_slots, 4))
    positions[0, 1], quaternions[0, 1] = position, (0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
    presence = np.arange(scenario.num_slots) == 1
    with Renderer(scenario, RESOLUTION) as renderer:
        return renderer.render(
            positions, quaternions, presence=presence, shapes=[int(shape)] * scenario.num_slots, background_seed=seed
        )


def points_seen(frames: Frames, camera: Camera, slot: int) -> np.ndarray:
    """(N, 3) metres: where in the world the pixels of an object are, by their depth."""
    rows, columns = np.nonzero(frames.segmentation[0] == slot)
    depth = frames.depth[0][rows, columns] / 1000
    half = RESOLUTION / 2
    reach = np.tan(np.radians(camera.field_of_view_deg) / 2) * depth / half
    forward = np.subtract(camera.target, camera.eye) / np.linalg.norm(np.subtract(camera.target, camera.eye))
    right = np.cross(forward, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(forward, (0.0, 0.0, 1.0)))
    up = np.cross(right, forward)
    across, along = (columns - half) * reach, (half - rows - 1) * reach  # TinyRenderer looks through lower left corners
    return camera.eye + depth[:, None] * forward + across[:, None] * right + along[:, None] * up


def test_the_pixels_of_a_cube_lie_on_its_faces(scenario_of: Callable[..., Scenario]) -> None:
    scenario, yaw = scenario_of("blocktower"), 0.5
    seen = points_seen(draw(scenario, Shape.BOX, (0.3, -0.4, 1.5), yaw), scenario.camera, 1) - (0.3, -0.4, 1.5)
    x, y = seen[:, 0] * np.cos(yaw) + seen[:, 1] * np.sin(yaw), seen[:, 1] * np.cos(yaw) - seen[:, 0] * np.sin(yaw)
    surface = np.abs(np.stack([x, y, seen[:, 2]])).max(axis=0)
    assert len(seen) > 300
    assert np.quantile(np.abs(surface - 0.5), 0.98) < 0.02  # pixels at an edge are seen at a slant


@pytest.mark.parametrize("name", ["balls", "collision"])
def test_the_pixels_of_a_sphere_lie_on_it(name: str, scenario_of: Callable[..., Scenario]) -> None:
    scenario = scenario_of(name)
    seen = points_seen(draw(scenario, Shape.SPHERE, (0.5, 0.6, 0.5)), scenario.camera, 1)
    radius = np.linalg.norm(seen - (0.5, 0.6, 0.5), axis=-1)
    assert np.quantile(np.abs(radius - 0.5), 0.95) < 0.02


def test_the_floor_is_where_it_is(scenario_of: Callable[..., Scenario]) -> None:
    scenario = scenario_of("collision")
    frames = draw(scenario, Shape.SPHERE, (0.0, 0.0, 0.5))
    floor = points_seen(frames, scenario.camera, NO_OBJECT)
    assert np.abs(floor[:, 2]).max() < 0.02
    assert (frames.depth > 0).all()  # no clipped floor


def test_a_segmentation_names_slots_and_only_those_present(scenario_of: Callable[..., Scenario]) -> None:
    frames = draw(scenario_of("balls"), Shape.SPHERE, (1.0, 0.0, 0.5))
    assert set(np.unique(frames.segmentation)) == {1, NO_OBJECT}
    rows, columns = np.nonzero(frames.segmentation[0] == 1)
    centre = np.array([columns.mean(), rows.mean()]) + 0.5
    expected = scenario_of("balls").camera.project(np.array((1.0, 0.0, 0.5)), RESOLUTION)
    assert np.linalg.norm(centre - expected) < 1.0


def test_the_same_seed_draws_the_same_picture_and_another_one_another(scenario_of: Callable[..., Scenario]) -> None:
    first, again, other = (
        draw(scenario_of("blocktower"), Shape.BOX, (0.0, 0.0, 0.5), seed=seed).rgb for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5


@pytest.mark.slow
@floors_of(FLOOR_PX)
def test_many_backgrounds_need_no_more_memory_than_a_few(scenario_of: Callable[..., Scenario]) -> None:
    scenario = scenario_of("collision")
    still = np.zeros((1, 4, 3)), np.tile((0.0, 0.0, 0.0, 1.0), (1, 4, 1))
    with Renderer(scenario, 16) as renderer:
        used = []
        for seed in range(60):
            renderer.render(*still, presence=np.zeros(4, dtype=bool), shapes=[0] * 4, background_seed=seed)
            used.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6)
    assert max(used[20:]) - max(used[:20]) < 100  # MB; each background has a texture of 13 MB


def test_objects_are_in_sight_from_start_to_end(tiny: tuple[DatasetSpec, dict[str, np.ndarray]]) -> None:
    """By their projected centres: all at t = 0, and 98 of 100 later (a falling block can leave towards the camera)."""
    spec, arrays = tiny
    positions = arrays["states"][:, :, :: spec.scenario.clock.states_per_frame, :, :3]
    pixels = spec.scenario.camera.project(positions, 448)
    inside = ((pixels > 22) & (pixels < 426)).all(axis=-1)  # a margin of 5 %
    present = np.broadcast_to(arrays["presence"][:, :, None], inside.shape)
    assert inside[:, :, 0][present[:, :, 0]].all()
    assert inside[present].mean() > 0.98


def test_a_backend_that_does_not_load_is_named(
    scenario_of: Callable[..., Scenario], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(CophyError, match=r"use render\.backend=tiny"):
        Renderer(scenario_of("balls"), 32, Backend.egl)


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="modalities"):
        RenderSettings(["rgb", "heat"], 64, Backend.tiny)
    with pytest.raises(ValueError, match="resolution=4 must"):
        RenderSettings(["rgb"], 4, Backend.tiny)


@floors_of(FLOOR_PX)
def test_floors_of_different_seeds_differ() -> None:
    floors = np.stack([floor_texture(seed)[::64, ::64].reshape(-1) for seed in range(12)]).astype(float)
    distance = np.abs(floors[:, None] - floors).mean(axis=-1)
    assert distance[~np.eye(len(floors), dtype=bool)].min() > 3
    assert backdrop_image(0, 32).shape == (32, 32, 3)
