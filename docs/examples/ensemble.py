"""Combine runs that differ in their seed: one prediction is one sample, so that the scorer gives the energy score.

python docs/examples/ensemble.py OUTPUT.npz outputs/collision/all/cophynet/full/ground_truth/seed{0,1,2}
"""

import sys
from pathlib import Path

import numpy as np


def main(output: Path, runs: list[Path]) -> None:
    """Write a file of predictions with one sample per run."""
    files = [np.load(run / "predictions.npz") for run in runs]
    experiment = files[0]["experiment"]
    if any(not np.array_equal(file["experiment"], experiment) for file in files):
        sys.exit("the runs were tested on different experiments")
    samples = np.stack([file["position"] for file in files], axis=1)  # (experiment, sample, frame, slot, xyz)
    np.savez_compressed(output, experiment=experiment, samples=samples)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(run) for run in sys.argv[2:]])
