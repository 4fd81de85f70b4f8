import numpy as np

from cophy.scenario.rendering import backdrop_image, floor_texture


def test_floors_of_different_seeds_differ() -> None:
    floors = np.stack([floor_texture(seed)[::64, ::64].reshape(-1) for seed in range(12)]).astype(float)
    distance = np.abs(floors[:, None] - floors).mean(axis=-1)
    assert distance[~np.eye(len(floors), dtype=bool)].min() > 3
    assert backdrop_image(0, 32).shape == (32, 32, 3)
