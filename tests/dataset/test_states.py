"""Generated experiments as arrays."""

from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.shards import encode
from cophy.dataset.splits import SPLITS
from cophy.dataset.states import TEST_TWINS, States, sort_by_twins, stable_frames, visible_axis
from cophy.scenario import Shape
from tests.dataset.copies import SPEC

UPRIGHT = [0.0, 0.0, 0.0, 1.0]
QUARTER = np.sqrt(0.5)


@pytest.fixture
def states(tiny_data: Path) -> States:
    return States(SPEC, tiny_data)


def test_a_shard_that_is_read_encodes_to_the_same_bytes(states: States) -> None:
    assert encode(states.read(0), states.fields(0), states.attributes(0)) == states.path(0).read_bytes()


def test_shards_are_concatenated_in_order(states: States) -> None:
    arrays, order = states.load(), SPEC.order
    np.testing.assert_array_equal(arrays["split"], order.split)
    tested = order.split == SPLITS.index("test")
    np.testing.assert_array_equal(arrays["twin"], np.where(tested, -1, order.pair))


def test_only_one_file_says_which_test_experiments_are_twins(states: States) -> None:
    arrays, order = states.load(), SPEC.order
    assert (arrays["twin"][arrays["split"] == SPLITS.index("test")] == -1).all()
    header, *lines = (states.directory / TEST_TWINS).read_text().splitlines()
    experiment, twin, cluster = np.array([line.split(",") for line in lines], dtype=int).T
    assert header == "experiment,twin,cluster"
    assert experiment.tolist() == np.flatnonzero(order.split == SPLITS.index("test")).tolist()
    np.testing.assert_array_equal(order.pair[experiment], twin)
    np.testing.assert_array_equal(states.clusters(experiment), cluster)


def test_pairs_of_a_cluster_were_assigned_the_same_confounders(states: States) -> None:
    arrays = sort_by_twins(states.load(), SPEC)
    first = {key: arrays[key][::2] for key in ("configuration", "split", "experiment")}
    cluster = states.clusters(first["experiment"])
    for number in np.unique(cluster):
        members = cluster == number
        assert len(set(first["configuration"][members])) == len(set(first["split"][members])) == 1
    assert len(set(cluster)) < len(cluster)


def test_sorted_by_twins_neighbours_share_a_and_the_first_twin_comes_first(states: States) -> None:
    arrays = sort_by_twins(states.load(), SPEC)
    np.testing.assert_array_equal(arrays["twin"][::2], arrays["twin"][1::2])
    np.testing.assert_array_equal(arrays["states"][::2, 0, 0], arrays["states"][1::2, 0, 0])
    assert not SPEC.order.second[arrays["experiment"][::2]].any()


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
