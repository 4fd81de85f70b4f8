"""Predict with a rule in NumPy, from the shards alone: D is B, shifted by how the do-operation moved each object.

python docs/examples/numpy_rule.py DATASET OUTPUT.npz
"""

import sys
from pathlib import Path

import h5py
import numpy as np

PER_FRAME = 4  # stored states per frame: attributes of a shard and the data card say so


def main(dataset: Path, output: Path) -> None:
    """Write a file of predictions."""
    ids, positions, first = [], [], 0
    for shard in sorted(dataset.glob("shard-*.h5")):
        with h5py.File(shard) as file:
            rows = np.flatnonzero(file["split"][:] == 2)  # test
            position = file["states"][:][rows, :, ::PER_FRAME, :, :3]  # (experiment, AB or CD, frame, slot, xyz)
            present = file["presence"][:][rows]
            ids.append(first + rows)
            first += len(file["split"])
        observed, initial = position[:, 0], position[:, 1, 0]  # D is position[:, 1, 1:]: it must not be used
        moved = np.where(present.all(axis=1)[..., None], initial - observed[:, 0], 0)
        positions.append(observed[:, 1:] + moved[:, None])
    np.savez_compressed(output, experiment=np.concatenate(ids), position=np.concatenate(positions))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
