"""The card of a dataset is true."""

import json
import textwrap
from pathlib import Path

import h5py
import pytest

from cophy.atomic_files import sha256
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
def test_every_array_says_what_it_is_in_the_file_the_card_and_the_metadata(name: str, tiny_data: Path) -> None:
    states = States(tiny_spec(name), tiny_data)
    card = (states.directory / "README.md").read_text()
    metadata = json.loads((states.directory / "croissant.json").read_bytes())
    described = {field["name"]: field["description"] for field in metadata["recordSet"][0]["field"]}
    with h5py.File(states.path(0)) as shard:
        assert described.keys() == shard.keys()
        for field, array in shard.items():
            assert len(array.attrs["axes"].split(", ")) == array.ndim, field
            meaning = array.attrs["meaning"]
            assert f"`{field}`" in card
            assert meaning in card
            assert meaning in described[field]


def test_the_metadata_name_every_file_and_its_checksum(tiny_data: Path) -> None:
    directory = States(tiny_spec("balls"), tiny_data).directory
    files = [
        file for file in json.loads((directory / "croissant.json").read_bytes())["distribution"] if "sha256" in file
    ]
    assert {file["contentUrl"] for file in files} == {path.name for path in directory.glob("*.h5")}
    assert all(file["sha256"] == sha256(directory / file["contentUrl"]) for file in files)
