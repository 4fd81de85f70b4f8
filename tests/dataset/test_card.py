"""The card of a dataset is true."""

import textwrap
from pathlib import Path

from tests.conftest import SCENARIOS, tiny_spec


def test_the_card_says_how_to_load_a_dataset(tiny_data: Path) -> None:
    """Its five lines of Python do what they say."""
    for name in SCENARIOS:
        directory = tiny_spec(name).directory(tiny_data)
        card = (directory / "README.md").read_text()
        found: dict = {}
        code = textwrap.dedent(card[card.index("    import h5py") : card.index("Audit:")])
        exec(code.replace("shard-00000.h5", str(directory / "shard-00000.h5")), found)
        assert found["states"].shape[:2] == (24, 2)
        assert found["present"].shape == found["states"].shape[:2] + found["mass"].shape[1:]
