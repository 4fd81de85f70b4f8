"""Shards of states: what they may hold, and that the same arrays are the same bytes."""

from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.fields import experiment_fields
from cophy.dataset.shards import DamagedShardError, encode
from cophy.dataset.states import States
from tests.dataset.copies import SPEC

FIELDS = experiment_fields(SPEC, len(SPEC.experiments_of_shard(0)))


@pytest.fixture
def states(tiny_data: Path) -> States:
    return States(SPEC, tiny_data)


def check_with_last(states: States, tmp_path: Path, name: str, value: int) -> None:
    """Check a shard in whose last experiment an array has another value."""
    arrays = states.read(0)
    arrays[name][-1] = value
    path = tmp_path / "shard.h5"
    path.write_bytes(encode(arrays, FIELDS, {}))
    states.check(path, 0)


@pytest.mark.parametrize(
    ("name", "value"),
    [("do_slot", 99), ("cell", 9), ("shape", 7), ("split", 3), ("configuration", -1), ("twin", 10**6)],
)
def test_an_index_out_of_range_is_damage(states: States, tmp_path: Path, name: str, value: int) -> None:
    with pytest.raises(DamagedShardError, match=f"'{name}' holds {value}, expected 0 to"):
        check_with_last(states, tmp_path, name, value)


@pytest.mark.parametrize(
    ("name", "value", "said"), [("object_index", -1, "does not count"), ("shape", 0, "other slots")]
)
def test_an_object_that_is_only_half_there_is_damage(
    states: States, tmp_path: Path, name: str, value: int, said: str
) -> None:
    with pytest.raises(DamagedShardError, match=f"'{name}' .*{said}"):
        check_with_last(states, tmp_path, name, value)


def test_what_is_read_encodes_to_the_same_bytes(states: States) -> None:
    assert encode(states.read(0), FIELDS, states.attributes(0)) == states.path(0).read_bytes()


def test_shards_are_concatenated_in_order(states: States) -> None:
    arrays = states.load()
    assert arrays["twin"].tolist() == np.repeat(np.arange(SPEC.num_experiments // 2), 2).tolist()
