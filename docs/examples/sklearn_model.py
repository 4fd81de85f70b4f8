"""Ridge regression with scikit-learn, from the shards alone: D - C is linear in products of the positions in AB and in C.

python docs/examples/sklearn_model.py DATASET OUTPUT.npz
"""

import sys
from pathlib import Path

import h5py
import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

PER_FRAME = 4  # stored states per frame


def read(dataset: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (experiment, AB or CD, frame, slot, xyz) and the splits of a dataset."""
    positions, splits = [], []
    for shard in sorted(dataset.glob("shard-*.h5")):
        with h5py.File(shard) as file:
            positions.append(file["states"][:, :, ::PER_FRAME, :, :3])
            splits.append(file["split"][:])
    return np.concatenate(positions), np.concatenate(splits)


def features(position: np.ndarray) -> np.ndarray:
    """Return the positions in AB at five times and in C: empty slots are zero, so they need no mask."""
    observed, initial = position[:, 0], position[:, 1, 0]
    times = np.linspace(0, observed.shape[1] - 1, 5).astype(int)
    return np.concatenate([observed[:, times].reshape(len(position), -1), initial.reshape(len(position), -1)], axis=1)


def main(dataset: Path, output: Path) -> None:
    """Fit, and write a file of predictions."""
    position, split = read(dataset)
    initial, outcome = position[:, 1, :1], position[:, 1, 1:]
    train, test = split == 0, split == 2
    model = make_pipeline(StandardScaler(), RidgeCV(np.logspace(-1, 5, 13)))
    model.fit(features(position[train]), (outcome - initial)[train].reshape(train.sum(), -1))
    motion = model.predict(features(position[test])).reshape(outcome[test].shape)
    np.savez_compressed(output, experiment=np.flatnonzero(test), position=initial[test] + motion)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
