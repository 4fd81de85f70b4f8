"""The card of a dataset is true."""

import textwrap
from pathlib import Path

import h5py
import pytest

from cophy.dataset.states import States
from tests.conftest import SCENARIOS, tiny_spec


def test_the_card_says_how_to_load_a_dataset(tiny_data: Path) -> None:
    """Its five lines of Python do what they say."""
    for name in SCENARIOS:
        directory = tiny_spec(name).directory(tiny_data)
        card = (directory / "README.md").read_text()
        found: dict = {}
        code = textwrap.dedent(card[card.index("    import h5py") : card.index("As a torch Dataset")])
        exec(code.replace("shard-00000.h5", str(directory / "shard-00000.h5")), found)
        assert found["states"].shape[:2] == (24, 2)
        assert found["present"].shape == found["states"].shape[:2] + found["mass"].shape[1:]


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_array_says_what_it_is_in_the_file_and_the_card(name: str, tiny_data: Path) -> None:
    states = States(tiny_spec(name), tiny_data)
    card = (states.directory / "README.md").read_text()
    with h5py.File(states.path(0)) as shard:
        for field, array in shard.items():
            assert len(array.attrs["axes"].split(", ")) == array.ndim, field
            assert f"`{field}`" in card
            assert array.attrs["meaning"] in card
