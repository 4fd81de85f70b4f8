"""What boosted trees read about masses and frictions off AB of towers of three: python benchmarks/probe_bound.py [data_dir]

A bound from below on what the probe of CoPhyNet's U (paper Table 5) could find: the true positions of all frames of the
dataset of 12,000 towers (docs/results.md says how to make it), blurred by independent Gaussian noise of a given size, one
classifier per block and confounder, apart for falling and for standing A. Eleven minutes on one core.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from physics import scenario
from rich.console import Console
from rich.table import Table
from sklearn.ensemble import HistGradientBoostingClassifier
from tqdm import tqdm

from cophy.app.registration import register
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.splits import SPLITS
from cophy.dataset.store.states import States

NOISE_M = (0.0, 0.001, 0.01, 0.03)
FRAMES = (1, 2, 3, 4, 5, 6, 8, 10, 14, 29)  # after the first; the fall is over by the tenth
NUM_BLOCKS = 3
SIZE = Size("12k", 100, {"blocktower": {"3": 12000}})


class Blocks(NamedTuple):
    """Three blocks of every tower, from bottom to top.

    Attributes:
        position: (tower, frame, 3, xyz) in AB, metres.
        mass: (tower, 3) kg.
        friction: (tower, 3).
        falls: (tower,) whether AB falls.
        split: (tower,) index into SPLITS.
    """

    position: np.ndarray
    mass: np.ndarray
    friction: np.ndarray
    falls: np.ndarray
    split: np.ndarray


def main(data_dir: Path) -> None:
    """Print the table."""
    register()
    blocks = stored_blocks(data_dir)
    table = Table("noise, m", "A", "test blocks", "mass, %", "friction, %", "both (4-way), %")
    for noise_m in tqdm(NOISE_M, unit="noise"):
        seen = features(blocks.position + np.random.default_rng(0).normal(0, noise_m, blocks.position.shape))
        for name, chosen in (("falls", blocks.falls), ("stands", ~blocks.falls)):
            table.add_row(f"{noise_m:g}", name, *scores(blocks, seen, chosen))
    Console().print(table)


def stored_blocks(data_dir: Path) -> Blocks:
    """Of the dataset of 12,000 towers."""
    towers = scenario("blocktower")
    arrays = States(DatasetSpec(towers, NUM_BLOCKS, SIZE, 0), data_dir).load()
    slots = np.stack([(arrays["object_index"] == level).argmax(axis=1) for level in range(NUM_BLOCKS)], axis=1)
    mass, friction = (np.take_along_axis(arrays[name], slots, axis=1) for name in ("mass", "friction"))
    frames = arrays["states"][:, 0, :: towers.clock.states_per_frame, :, :3]
    position = np.take_along_axis(frames, slots[:, None, :, None], axis=2).astype(np.float64)
    falls = np.linalg.norm(position - position[:, :1], axis=-1).max(axis=(1, 2)) > towers.fallen_distance
    return Blocks(position, mass, friction, falls, arrays["split"])


def scores(blocks: Blocks, seen: np.ndarray, chosen: np.ndarray) -> list[str]:
    """Number of test blocks, and the shares read rightly of mass, friction, and both.

    Args:
        blocks: Of all towers.
        seen: (tower, feature) what the classifiers see.
        chosen: (tower,) bool, which towers they are fitted and tested on.
    """
    train, test = (chosen & (blocks.split == SPLITS.index(split)) for split in ("train", "test"))
    mass, friction = (
        np.stack([_right(seen[train], of[train, k], seen[test], of[test, k]) for k in range(NUM_BLOCKS)])
        for of in (blocks.mass, blocks.friction)
    )
    shares = [f"{100 * right.mean():.0f}" for right in (mass, friction, mass & friction)]
    return [str(NUM_BLOCKS * test.sum()), *shares]


def features(position: np.ndarray) -> np.ndarray:
    """(N, T, K, 3) -> (N, features): offsets of neighbouring blocks at t = 0, and what they and every block did since."""
    offset = np.diff(position, axis=2)
    since = position[:, FRAMES] - position[:, :1]
    parts = (offset[:, 0], offset[:, FRAMES], since)
    return np.concatenate([part.reshape(len(position), -1) for part in parts], axis=1)


def _right(train: np.ndarray, of_train: np.ndarray, test: np.ndarray, of_test: np.ndarray) -> np.ndarray:
    classifier = HistGradientBoostingClassifier(random_state=0).fit(train, of_train > of_train.mean())
    return np.asarray(classifier.predict(test) == (of_test > of_train.mean()))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "data"))
