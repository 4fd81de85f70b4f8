"""README.md of a folder of pictures."""

from pathlib import Path

from cophy.atomic_files import write_atomically
from cophy.dataset.cards.dataset_card import CARD
from cophy.dataset.cards.field_table import field_table
from cophy.dataset.store.hdf5_arrays import Fields


def write_picture_card(directory: Path, title: str, command: str, fields: Fields) -> None:
    """Write the card.

    Args:
        directory: Of the pictures.
        title: What they are.
        command: What makes or repairs them.
        fields: Arrays of the first shard.
    """
    text = f"""# {title}

Frames of the experiments in the folder above, shard by shard. `manifest.json` holds what was rendered, and a SHA-256 per
file. To make or repair them:

    {command}

They are compressed with Zstd, which h5py reads once `hdf5plugin` is imported:

    import h5py, hdf5plugin
    with h5py.File("shard-00000.h5") as shard:
        boxes = shard["boxes"][0]  # both sequences of the first experiment

{field_table(fields)}

Licence: Apache-2.0, as cophy.
"""
    write_atomically(directory / CARD, text.encode())
