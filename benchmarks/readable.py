"""What boosted trees read about masses and frictions off AB of towers of three: python benchmarks/readable.py [data_dir]

A bound from below on what the probe of CoPhyNet's U (paper Table 5) could find: the true positions of all frames of the
dataset of 12,000 towers (docs/results.md says how to make it), blurred by independent Gaussian noise of a given size, one
classifier per block and confounder, apart for falling and for standing A. Eleven minutes on one core.
"""

import sys
from pathlib import Path

import numpy as np
from physics import scenario
from rich.console import Console
from rich.table import Table
from sklearn.ensemble import HistGradientBoostingClassifier
from tqdm import tqdm

from cophy import config
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.splits import SPLITS
from cophy.dataset.states import States

NOISE_M = (0.0, 0.001, 0.01, 0.03)
FRAMES = (1, 2, 3, 4, 5, 6, 8, 10, 14, 29)  # after the first; the fall is over by the tenth
NUM_BLOCKS = 3


def main(data_dir: Path) -> None:
    """Print the table."""
    config.register()
    towers = scenario("blocktower")
    arrays = States(DatasetSpec(towers, NUM_BLOCKS, Size("12k", 100, {"blocktower": {"3": 12000}}), 0), data_dir).load()
    slots = np.stack([(arrays["object_index"] == level).argmax(axis=1) for level in range(NUM_BLOCKS)], axis=1)
    mass, friction = (np.take_along_axis(arrays[name], slots, axis=1) for name in ("mass", "friction"))
    frames = arrays["states"][:, 0, :: towers.clock.states_per_frame, :, :3]
    position = np.take_along_axis(frames, slots[:, None, :, None], axis=2).astype(np.float64)  # bottom to top
    falls = np.linalg.norm(position - position[:, :1], axis=-1).max(axis=(1, 2)) > towers.fallen_distance
    train, test = (arrays["split"] == SPLITS.index(split) for split in ("train", "test"))
    table = Table("noise, m", "A", "test blocks", "mass, %", "friction, %", "both (4-way), %")
    for noise_m in tqdm(NOISE_M, unit="noise"):
        seen = features(position + np.random.default_rng(0).normal(0, noise_m, position.shape))
        for name, chosen in (("falls", falls), ("stands", ~falls)):
            a, b = train & chosen, test & chosen
            right = [
                np.stack([_right(seen[a], of[a, k], seen[b], of[b, k]) for k in range(NUM_BLOCKS)])
                for of in (mass, friction)
            ]
            shares = [f"{100 * r.mean():.0f}" for r in (*right, right[0] & right[1])]
            table.add_row(f"{noise_m:g}", name, str(NUM_BLOCKS * b.sum()), *shares)
    Console().print(table)


def features(position: np.ndarray) -> np.ndarray:
    """(N, T, K, 3) -> (N, features): offsets of neighbouring blocks at t = 0, and what they and every block did since."""
    offset = np.diff(position, axis=2)
    since = position[:, FRAMES] - position[:, :1]
    parts = (offset[:, 0], offset[:, FRAMES], since)
    return np.concatenate([part.reshape(len(position), -1) for part in parts], axis=1)


def _right(train: np.ndarray, of_train: np.ndarray, test: np.ndarray, of_test: np.ndarray) -> np.ndarray:
    classifier = HistGradientBoostingClassifier(random_state=0).fit(train, of_train > of_train.mean())
    return classifier.predict(test) == (of_test > of_train.mean())


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "data"))
