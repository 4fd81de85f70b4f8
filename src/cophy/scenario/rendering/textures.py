"""Procedural textures of floors and backdrops: hundreds of them, each a pure function of an experiment's background seed."""

from collections.abc import Callable

import cv2
import numpy as np

FLOOR_PX = 2048
STREAMS = {"floor": 0, "backdrop": 1}  # so that a backdrop of any resolution changes no floor


def floor_texture(seed: int) -> np.ndarray:
    """(2048, 2048, 3) uint8: smooth ground, tiles, planks or terrazzo in muted colours, so that objects stand out."""
    rng = np.random.default_rng((seed, STREAMS["floor"]))
    pattern = PATTERNS[rng.integers(len(PATTERNS))](rng)
    light, dark = _muted(rng, brightness=(0.72, 0.95)), _muted(rng, brightness=(0.5, 0.7))
    return _colored(pattern, dark, light)


def backdrop(seed: int, resolution: int) -> np.ndarray:
    """(resolution, resolution, 3) uint8: a soft gradient, shown where there is no floor."""
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
    inside = np.arange(FLOOR_PX) * count % FLOOR_PX >= 3 * count  # the first three pixels of a tile are its joint
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
    """(size, size) smooth random values around 0.5, about `cells` bumps across."""
    return cv2.resize(rng.random((cells, cells), dtype=np.float32), (size, size), interpolation=cv2.INTER_CUBIC)


def _muted(rng: np.random.Generator, brightness: tuple[float, float]) -> np.ndarray:
    hsv = np.array([[[rng.uniform(0, 360), rng.uniform(0.03, 0.28), rng.uniform(*brightness)]]], dtype=np.float32)
    return 255 * cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0]


def _colored(blend: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    palette = np.rint(low + np.linspace(0, 1, 256)[:, None] * (high - low)).astype(np.uint8)
    shade = 255 * blend
    index = np.clip(shade, 0, 255, out=shade).astype(np.uint8)
    return cv2.merge([cv2.LUT(index, channel) for channel in palette.T.copy()])
