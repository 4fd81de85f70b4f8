from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cophy.dataset.spec import DatasetSpec
from cophy.dataset.store.states import States
from cophy.scenario import Collision, Shape
from tests.conftest import tiny_spec


@pytest.fixture
def collisions(tiny_data: Path) -> tuple[DatasetSpec, dict[str, np.ndarray]]:
    spec = tiny_spec("collision")
    return spec, States(spec, tiny_data).load()


def test_a_cell_is_named_by_its_shapes() -> None:
    assert Collision.cells() == ("sphere_sphere", "sphere_cylinder", "cylinder_sphere", "cylinder_cylinder")


def test_one_object_moves_and_its_shape_is_that_of_the_cell(collisions) -> None:
    spec, arrays = collisions
    moves = np.linalg.norm(arrays["states"][:, 0, 0, :, 7:10], axis=-1) > 0
    assert (moves.sum(axis=1) == 1).all()
    shapes = [spec.scenario.shapes_of_cell(cell) for cell in arrays["cell"]]
    assert arrays["shape"][moves].tolist() == [moving for moving, _ in shapes]
    still = (arrays["shape"] > 0) & ~moves
    assert arrays["shape"][still].tolist() == [static for _, static in shapes]


def test_a_moving_cylinder_rolls(collisions) -> None:
    """It lies with its axis across its path."""
    _, arrays = collisions
    states = arrays["states"][:, 0]
    moves = np.linalg.norm(states[:, 0, :, 7:10], axis=-1) > 0
    cylinders = np.argwhere(moves & (arrays["shape"] == Shape.CYLINDER))
    assert len(cylinders)
    for experiment, slot in cylinders:
        axis = Rotation.from_quat(states[experiment, 0, slot, 3:7]).apply((0.0, 0.0, 1.0))
        np.testing.assert_allclose(axis @ [0, 0, 1], 0, atol=1e-6)
        np.testing.assert_allclose(axis @ states[experiment, 0, slot, 7:10], 0, atol=1e-5)
