"""What true positions of towers tell about masses: python benchmarks/results/masses_from_ab.py [--data-dir FOLDER]

Prints how far the lowest block sinks in the first frame, how many masses of validation experiments extra trees read off AB and their MSE
of D, from positions as stored and rounded; and for how many C statics with the true masses and gravity tell whether they stand, with and
without the yaw of the blocks. Towers of three, size=small, data seed 0; three CPU-minutes.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from sklearn.ensemble import ExtraTreesClassifier
from torch import Tensor

import cophy
from cophy.config import folder
from cophy.dataset.features import to_batch
from cophy.models.hypotheses import TowerHypotheses, find_joints, yaw_of
from cophy.models.trees import Trees
from cophy.scenario import Blocktower
from cophy.training.metrics import mean_squared_error
from cophy.types import Batch, Inputs, Targets

NUM_OBJECTS = 3
HEAVY = 5.0  # kg; masses are 1 and 10
FRAMES = [1, 2, 3, 5, 8, 12, 18, 29]  # of AB, that the trees see
ROUNDED_TO = (0.0, 1e-4, 1e-3, 1e-2)  # metres; 0: as stored


def main(data_dir: Path) -> None:
    """Load training and validation experiments, and print what the module says."""
    data = {split: cophy.load("blocktower", split=split, data_dir=data_dir) for split in ("train", "val")}
    scenario = data["train"].scenario
    assert isinstance(scenario, Blocktower)
    batches = {split: to_batch(each.arrays, scenario, ("pose",)) for split, each in data.items()}
    order = {split: blocks_from_the_ground(batch.inputs) for split, batch in batches.items()}
    heavy = {
        split: np.take_along_axis(each.arrays["mass"], order[split].numpy(), axis=1) > HEAVY
        for split, each in data.items()
    }
    train = batches["train"].inputs
    sinks = 1e6 * (train.observed[:, 0] - train.observed[:, 1])[..., 2].gather(1, order["train"])[:, 0].numpy()
    for masses in product((False, True), repeat=NUM_OBJECTS):
        median = np.median(sinks[(heavy["train"] == masses).all(axis=1)])
        print(f"heavy, from the ground up: {masses}: the lowest block sinks by {median:.0f} µm (median)")
    for step in ROUNDED_TO:
        seen = {split: rounded(batch, step) for split, batch in batches.items()}
        moved = {split: moved_blocks(seen[split], order[split]) for split in seen}
        right = []
        for level in range(NUM_OBJECTS):
            trees = ExtraTreesClassifier(200, min_samples_leaf=2, random_state=0)
            trees.fit(moved["train"], heavy["train"][:, level])
            right.append(np.mean(trees.predict(moved["val"]) == heavy["val"][:, level]))
        model = Trees(num_trees=40, min_samples_leaf=2)  # as conf/model/trees.yaml
        model.fit(seen["train"], scenario, (torch.zeros(0), torch.ones(0)), seed=0)
        mse = mean_squared_error(scenario.task.metric_dims)(model(seen["val"].inputs), batches["val"].targets).mean()
        print(f"rounded to {step:g} m: masses {np.mean(right):.1%} right, MSE of extra trees {mse:.4f} m²")
    for yaw in ("unknown", "known"):
        margin = margins_of_c(data["train"].arrays, train, yaw == "known")
        stands = stands_in_d(batches["train"].targets, scenario.fallen_distance)
        print(
            f"statics with true masses and gravity, yaw {yaw}: right for {((margin > 0) == stands).double().mean():.1%} of C"
        )


def blocks_from_the_ground(inputs: Inputs) -> Int[Tensor, "batch 3"]:
    """Return the slots of the three blocks of A, the lowest first."""
    height = torch.where(inputs.observed_presence, inputs.observed[:, 0, :, 2], torch.inf)
    return height.argsort(dim=1)[:, :NUM_OBJECTS]


def moved_blocks(batch: Batch, order: Int[Tensor, "batch 3"]) -> np.ndarray:
    """Return what the trees see: how far each block, from the ground up, has moved in some frames of AB."""
    moved = (batch.inputs.observed - batch.inputs.observed[:, :1])[:, FRAMES]
    return moved.gather(2, order[:, None, :, None].expand(-1, len(FRAMES), -1, 3)).flatten(1).numpy()


def margins_of_c(arrays: Mapping[str, np.ndarray], inputs: Inputs, with_yaw: bool) -> Tensor:
    """Return how far each C is from toppling under the true masses and gravity, metres."""
    mass = torch.from_numpy(arrays["mass"]).float()[:, None]
    tilt = torch.from_numpy(arrays["gravity"][:, :2] / -arrays["gravity"][:, 2:]).float()[:, None]
    assert inputs.pose is not None
    yaw = yaw_of(inputs.pose) if with_yaw else None
    margins = find_joints(TowerHypotheses(inputs.initial, inputs.presence, yaw, mass, tilt)).margin  # edges are 1 m
    return margins[:, 0].amin(dim=1)


def stands_in_d(targets: Targets, fallen_distance: float) -> Tensor:
    """Return for each experiment whether no block of D is ever farther than this from C, metres."""
    distance = (targets.position - targets.initial[:, None]).norm(dim=-1).amax(dim=1)
    return torch.where(targets.presence, distance, 0.0).amax(dim=1) < fallen_distance


def rounded(batch: Batch, step: float) -> Batch:
    """Return a batch whose inputs are rounded to multiples of a length."""
    if not step:
        return batch
    inputs = batch.inputs
    observed, initial = (step * (each / step).round() for each in (inputs.observed, inputs.initial))
    return replace(batch, inputs=replace(inputs, observed=observed, initial=initial))


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--data-dir", type=Path, default=Path(folder("COPHY_DATA")), help="where the dataset lies")
    main(**vars(parser.parse_args()))
