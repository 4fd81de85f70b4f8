import numpy as np
import pytest
import yaml

from cophy.config import CONF
from cophy.dataset.splits import SPLITS, Part, Split, StoredOrder, stored_order


def order_of(num_experiments: int, **changed: int) -> StoredOrder:
    return stored_order(num_experiments, 100, **({"num_objects": 3, "data_seed": 0} | changed))


def test_splits_are_seven_two_one_and_keep_twins_together() -> None:
    order = order_of(2000)
    assert np.bincount(order.split).tolist() == [1400, 400, 200]
    assert SPLITS == ("train", "val", "test")
    for values in (order.split, order.number):
        assert all(len(np.unique(values[order.pair == pair])) == 1 for pair in range(1000))


def test_every_twin_of_every_pair_is_stored_once_both_in_one_shard() -> None:
    order = order_of(2000)
    made = set(zip(order.split.tolist(), order.number.tolist(), order.second.tolist(), strict=True))
    assert len(made) == 2000
    assert [order.number[order.split == split].max() + 1 for split in range(3)] == [700, 200, 100]
    shards = [set(np.flatnonzero(order.pair == pair) // 100) for pair in range(1000)]
    assert all(len(shard) == 1 for shard in shards)


def test_the_order_is_random() -> None:
    order, other = order_of(2000), order_of(2000, data_seed=1)
    assert (order.number != other.number).mean() > 0.9
    index = np.arange(2000)
    for values in (order.number[order.split == 0], order.second[order.split == 0]):
        assert abs(np.corrcoef(index[order.split == 0], values)[0, 1]) < 0.1
    neighbours = order.pair[1:] == order.pair[:-1]
    assert neighbours.mean() < 0.05, "twins are rarely next to each other"


def test_splits_of_a_small_dataset_are_parts_of_those_of_a_large_one() -> None:
    small, large = (
        {*zip(each.split.tolist(), each.number.tolist(), strict=True)} for each in map(order_of, (200, 2000))
    )
    assert small < large


def test_the_moving_object_selects_its_experiments(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "collision":
        pytest.skip("collision only")
    sphere, cylinder = (Part(2, moving=shape).select(arrays) for shape in ("sphere", "cylinder"))
    np.testing.assert_array_equal(sphere, ~cylinder)
    names = np.array(spec.scenario.cells())[arrays["cell"]]
    np.testing.assert_array_equal(sphere, np.char.startswith(names, "sphere"))


def test_seen_and_unseen_configurations_never_meet(tiny) -> None:
    _, arrays = tiny
    seen, unseen = (Part(3, configurations=which).select(arrays) for which in ("seen", "unseen"))
    np.testing.assert_array_equal(seen, ~unseen)
    assert not set(arrays["configuration"][seen]) & set(arrays["configuration"][unseen])
    np.testing.assert_array_equal(seen[::2], seen[1::2])


def test_a_part_that_means_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="neither sphere nor cylinder"):
        Part(2, moving="cube")


def test_every_split_tests_something_at_the_smallest_size(tiny) -> None:
    """So that every table can be tried in seconds."""
    spec, arrays = tiny
    for name in spec.scenario.task.splits:
        keys = yaml.safe_load((CONF / "split" / f"{name}.yaml").read_text())
        split = Split(name, Part(**keys["train"]), Part(**keys["test"]))
        parts = {"train": split.train, "val": split.train, "test": split.test}
        counts = {which: part.select_split(arrays, which).sum() for which, part in parts.items()}
        assert min(counts.values()) > 0, (name, counts)
