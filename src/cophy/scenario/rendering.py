"""Rendering of states to RGB, depth and instance segmentation, with PyBullet's renderers and a scenario's fixed camera.

Textures of floors and backdrops are procedural: each is a pure function of an experiment's background seed.
"""

import importlib.util
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from PIL import ImageColor

from cophy.errors import CophyError
from cophy.scenario.physics import Shape
from cophy.scenario.scenario import Scenario
from cophy.scenario.simulator import import_pybullet

NO_OBJECT = 255  # in segmentations


class Backend(Enum):
    """Renderers: PyBullet's CPU renderer (tiny), or its OpenGL plugin, on a GPU or on Mesa in software (egl)."""

    tiny = "tiny"
    egl = "egl"


@dataclass
class RenderSettings:
    """Fields of the files in conf/render: modalities are rgb, depth, segmentation, or none of them."""

    modalities: list[str]
    resolution: int
    backend: Backend

    def __post_init__(self) -> None:
        unknown = set(self.modalities) - set(MODALITIES)
        if unknown:
            raise ValueError(f"render.modalities={list(self.modalities)} must be some of {list(MODALITIES)}")
        if len(set(self.modalities)) < len(self.modalities):
            raise ValueError(f"render.modalities={list(self.modalities)} names a modality twice")
        if not 16 <= self.resolution <= 4096:
            raise ValueError(f"render.resolution={self.resolution} must be between 16 and 4096 pixels")


class Frames(NamedTuple):
    """Images of one sequence, R × R pixels.

    Attributes:
        rgb: (T, R, R, 3) uint8.
        depth: (T, R, R) uint16, millimetres along the camera's axis; 0 for the backdrop.
        segmentation: (T, R, R) uint8, slot of the visible object, or NO_OBJECT.
    """

    rgb: np.ndarray
    depth: np.ndarray
    segmentation: np.ndarray


MODALITIES = Frames._fields


FLOOR_PX = 2048
STREAMS = {
    "floor": 0,
    "backdrop": 1,
}  # separate seeds, so that the resolution of the backdrop does not change the floor


def floor_texture(seed: int) -> np.ndarray:
    """Return (2048, 2048, 3) uint8 ground, tiles, planks or terrazzo in muted colours, so that objects stand out."""
    rng = np.random.default_rng((seed, STREAMS["floor"]))
    pattern = PATTERNS[rng.integers(len(PATTERNS))](rng)
    light, dark = _muted(rng, brightness=(0.72, 0.95)), _muted(rng, brightness=(0.5, 0.7))
    return _colored(pattern, dark, light)


def backdrop_image(seed: int, resolution: int) -> np.ndarray:
    """Return a (resolution, resolution, 3) uint8 gradient, which is visible where there is no floor."""
    rng = np.random.default_rng((seed, STREAMS["backdrop"]))
    gradient = np.linspace(0, 1, resolution)[:, None].repeat(resolution, axis=1)
    blend = np.clip(gradient + 0.15 * (_noise(rng, resolution, cells=3) - 0.5), 0, 1)
    return _colored(blend, _muted(rng, brightness=(0.6, 0.85)), _muted(rng, brightness=(0.85, 1.0)))


def _ground(rng: np.random.Generator) -> np.ndarray:
    octaves = [_noise(rng, FLOOR_PX, cells=cells) for cells in (9, 28, 86, 260)]
    return np.tensordot(np.array((0.4, 0.3, 0.2, 0.1), dtype=np.float32), octaves, axes=1)


def _tiles(rng: np.random.Generator) -> np.ndarray:
    count = int(rng.integers(17, 43))
    index = np.arange(FLOOR_PX) * count // FLOOR_PX
    shade = rng.uniform(0.5, 0.5 + rng.uniform(0.1, 0.45), (count, count))
    if rng.random() < 0.5:
        shade += 0.25 * (np.indices(shade.shape).sum(axis=0) % 2) - 0.1
    inside = np.arange(FLOOR_PX) * count % FLOOR_PX >= 3 * count  # the first three pixels of a tile are the joint
    return np.where(inside[:, None] & inside, shade[index[:, None], index], 0.2) + 0.1 * _noise(rng, FLOOR_PX, cells=80)


def _planks(rng: np.random.Generator) -> np.ndarray:
    count, length = int(rng.integers(40, 90)), int(rng.integers(120, 320))
    row = np.arange(FLOOR_PX) * count // FLOOR_PX
    along = np.arange(FLOOR_PX) + rng.integers(0, length, count)[row][:, None]
    shade = rng.uniform(0.35, 0.85, (count, FLOOR_PX // length + 2))[row[:, None], along // length]
    grain = cv2.resize(
        rng.random((FLOOR_PX, 16), dtype=np.float32), (FLOOR_PX, FLOOR_PX), interpolation=cv2.INTER_CUBIC
    )
    joint = (along % length < 3) | (np.arange(FLOOR_PX) * count % FLOOR_PX < 3 * count)[:, None]
    planks = np.where(joint, 0.15, shade + 0.2 * (grain - 0.5))
    return planks if rng.random() < 0.5 else planks.T


def _terrazzo(rng: np.random.Generator) -> np.ndarray:
    specks = np.full((FLOOR_PX, FLOOR_PX), 0.6)
    for x, y, size, shade in zip(
        *rng.integers(0, FLOOR_PX, (2, 6000)).tolist(), rng.integers(2, 9, 6000).tolist(), rng.random(6000), strict=True
    ):
        cv2.circle(specks, (x, y), size, shade, thickness=-1, lineType=cv2.LINE_AA)
    return specks


PATTERNS: tuple[Callable[[np.random.Generator], np.ndarray], ...] = (_ground, _tiles, _planks, _terrazzo)


def _noise(rng: np.random.Generator, size: int, *, cells: int) -> np.ndarray:
    """Return (size, size) smooth random values around 0.5, with about `cells` bumps per side."""
    return cv2.resize(rng.random((cells, cells), dtype=np.float32), (size, size), interpolation=cv2.INTER_CUBIC)


def _muted(rng: np.random.Generator, brightness: tuple[float, float]) -> np.ndarray:
    hsv = np.array([[[rng.uniform(0, 360), rng.uniform(0.03, 0.28), rng.uniform(*brightness)]]], dtype=np.float32)
    return 255 * cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0]


def _colored(blend: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    palette = np.rint(low + np.linspace(0, 1, 256)[:, None] * (high - low)).astype(np.uint8)
    shade = 255 * blend
    index = np.clip(shade, 0, 255, out=shade).astype(np.uint8)
    return cv2.merge([cv2.LUT(index, channel) for channel in palette.T.copy()])


# Images depend on these constants: increase IMAGE_FORMAT in dataset/images.py with them.
FLOOR_HALF_WIDTH_M = 24.0  # the backdrop is beyond
VISIBLE_WALL_M = 0.4  # walls are drawn low, so that the near one hides nothing
WALL_COLOR = (0.8, 0.8, 0.8, 1.0)
RENDER_NEAR_M = 0.01  # so near that TinyRenderer's shadows are right; depth loses a millimetre or two of precision
RENDER_FAR_M = 60.0
LIGHT = {
    "lightDirection": [-2.5, -1.2, 12],
    "lightDistance": 40,
    "lightColor": [1, 1, 1],
    "lightAmbientCoeff": 0.55,
    "lightDiffuseCoeff": 0.45,
    "lightSpecularCoeff": 0.05,
}
# then the renderer reconnects, because PyBullet keeps every texture, 13 MB each, until the end of a connection
MAX_STAGES_PER_CONNECTION = 16


class Renderer:
    """A PyBullet client that renders, closed on leaving the `with` block.

    Attributes:
        camera_seconds: CPU time of PyBullet's camera.
    """

    def __init__(self, scenario: Scenario, resolution: int, backend: Backend = Backend.tiny) -> None:
        self.scenario, self.resolution, self.backend = scenario, resolution, backend
        self.camera_seconds = 0.0
        self._bullet = import_pybullet()
        tiny = backend is Backend.tiny
        self._kind = self._bullet.ER_TINY_RENDERER if tiny else self._bullet.ER_BULLET_HARDWARE_OPENGL
        self._connect()
        camera = scenario.camera
        self._camera = {
            "viewMatrix": self._bullet.computeViewMatrix(camera.eye, camera.target, [0, 0, 1]),
            "projectionMatrix": self._bullet.computeProjectionMatrixFOV(
                camera.field_of_view_deg, 1.0, RENDER_NEAR_M, RENDER_FAR_M
            ),
        }
        self._colors = [_rgba(color) for color in scenario.colors.values()]

    def _connect(self) -> None:
        self._client = self._bullet.connect(self._bullet.DIRECT)
        self._seed: int | None = None
        self._num_stages = 0
        self._objects: dict[int, int] = {}  # body -> slot
        if self.backend is Backend.egl:
            self._load_egl()

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *error: object) -> None:
        self._bullet.disconnect(self._client)

    def render(
        self,
        positions: np.ndarray,
        quaternions: np.ndarray,
        *,
        presence: np.ndarray,
        shapes: Sequence[int],
        background_seed: int,
    ) -> Frames:
        """Render a sequence.

        Args:
            positions: (T, K, 3), metres.
            quaternions: (T, K, 4), x y z w.
            presence: (K,) bool, the slots to render.
            shapes: `Shape` of each slot.
            background_seed: Seed of floor and backdrop.
        """
        if background_seed != self._seed:
            self._set_stage(background_seed)
        for body in self._objects:
            self._bullet.removeBody(body, self._client)
        self._objects = {self._add(Shape(shapes[slot]), slot): slot for slot in np.flatnonzero(presence).tolist()}
        return Frames(*map(np.stack, zip(*map(self._render_frame, positions, quaternions), strict=True)))

    def _render_frame(self, position: np.ndarray, quaternion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        for body, slot in self._objects.items():
            self._bullet.resetBasePositionAndOrientation(body, position[slot], quaternion[slot], self._client)
        start, size = time.process_time(), self.resolution
        _, _, rgba, z, bodies = self._bullet.getCameraImage(
            size, size, **self._camera, **LIGHT, shadow=1, renderer=self._kind, physicsClientId=self._client
        )
        self.camera_seconds += time.process_time() - start
        rgb = cv2.cvtColor(np.asarray(rgba, dtype=np.uint8).reshape(size, size, 4), cv2.COLOR_RGBA2RGB)
        bodies = np.asarray(bodies).reshape(size, size)
        background = bodies < 0
        cv2.copyTo(self._backdrop, background.view(np.uint8), rgb)
        slots = np.full(max(self._objects, default=0) + 2, NO_OBJECT, dtype=np.uint8)  # the last is -1, the background
        slots[list(self._objects)] = list(self._objects.values())
        segmentation = slots[np.minimum(bodies, len(slots) - 2)]
        depth = _millimetres(np.asarray(z).reshape(size, size))
        depth[background] = 0
        return rgb, depth, segmentation

    def _set_stage(self, seed: int) -> None:
        """Remove everything, and add floor, walls and backdrop."""
        if self._num_stages == MAX_STAGES_PER_CONNECTION:
            self._bullet.disconnect(self._client)
            self._connect()
        bullet, client = self._bullet, self._client
        bullet.resetSimulation(physicsClientId=client)
        self._seed, self._objects = seed, {}
        self._num_stages += 1
        self._backdrop = backdrop_image(seed, self.resolution)
        half = [FLOOR_HALF_WIDTH_M, FLOOR_HALF_WIDTH_M, 0.5]
        floor = self._body(bullet.createVisualShape(bullet.GEOM_BOX, halfExtents=half, physicsClientId=client), -0.5)
        with tempfile.TemporaryDirectory() as directory:  # PyBullet reads textures from files only
            path = Path(directory) / "floor.bmp"
            cv2.imwrite(str(path), cv2.cvtColor(floor_texture(seed), cv2.COLOR_RGB2BGR))
            texture = bullet.loadTexture(str(path), physicsClientId=client)
        bullet.changeVisualShape(floor, -1, textureUniqueId=texture, physicsClientId=client)
        for wall in self.scenario.walls():
            half = [wall.size_m[0] / 2, wall.size_m[1] / 2, VISIBLE_WALL_M / 2]
            shape = bullet.createVisualShape(
                bullet.GEOM_BOX, halfExtents=half, rgbaColor=WALL_COLOR, physicsClientId=client
            )
            self._body(shape, VISIBLE_WALL_M / 2, *wall.position[:2])

    def _add(self, shape: Shape, slot: int) -> int:
        bullet, size = self._bullet, self.scenario.object_size_m
        if shape is Shape.BOX:
            geometry = {"shapeType": bullet.GEOM_BOX, "halfExtents": [size / 2] * 3}
        elif shape is Shape.CYLINDER:
            geometry = {"shapeType": bullet.GEOM_CYLINDER, "radius": size / 2, "length": size}
        else:  # Bullet's own sphere is a coarse mesh
            import pybullet_data

            smooth = str(Path(pybullet_data.getDataPath()) / "sphere_smooth.obj")  # of radius 1
            geometry = {"shapeType": bullet.GEOM_MESH, "fileName": smooth, "meshScale": [size / 2] * 3}
        return self._body(
            bullet.createVisualShape(**geometry, rgbaColor=self._colors[slot], physicsClientId=self._client)
        )

    def _body(self, shape: int, z: float = 0.0, x: float = 0.0, y: float = 0.0) -> int:
        return int(
            self._bullet.createMultiBody(
                baseVisualShapeIndex=shape, basePosition=[x, y, z], physicsClientId=self._client
            )
        )

    def _load_egl(self) -> None:
        spec = importlib.util.find_spec("eglRenderer")
        client = self._client
        if spec is None or self._bullet.loadPlugin(spec.origin, "_eglRendererPlugin", physicsClientId=client) < 0:
            raise CophyError("render.backend=egl: PyBullet's EGL plugin does not load here; use render.backend=tiny")


def _rgba(color: str) -> tuple[float, ...]:
    """Convert "#rrggbb" to opaque RGBA values between 0 and 1."""
    return (*(value / 255 for value in ImageColor.getrgb(color)), 1.0)


def _millimetres(depth_buffer: np.ndarray) -> np.ndarray:
    """Return (R, R) uint16 distances along the camera's axis; in place, because new arrays would take six times as long."""
    depth = np.multiply(depth_buffer, RENDER_FAR_M - RENDER_NEAR_M, dtype=np.float64)
    np.subtract(RENDER_FAR_M, depth, out=depth)
    np.divide(RENDER_FAR_M * RENDER_NEAR_M, depth, out=depth)
    depth *= 1000
    return np.rint(depth, out=depth).astype(np.uint16)
