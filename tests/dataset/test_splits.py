import numpy as np
import pytest
import yaml

from cophy.config import CONF
from cophy.dataset.splits import SPLITS, Part, Split, split_of_experiments


def test_splits_are_seven_two_one_and_keep_twins_together() -> None:
    split = split_of_experiments(2000, data_seed=0)
    np.testing.assert_array_equal(split[::2], split[1::2])
    assert np.bincount(split).tolist() == [1400, 400, 200]
    assert SPLITS == ("train", "val", "test")


def test_another_seed_splits_otherwise() -> None:
    assert (split_of_experiments(2000, data_seed=0) != split_of_experiments(2000, data_seed=1)).any()


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
