"""What U of a trained CoPhyNet holds about masses and frictions of towers of three, asked in other ways than Table 5 asks:

    python benchmarks/results/estimate_contents.py outputs/blocktower/3to3/cophynet/full/ground_truth/seed0 [data_dir]

Classifiers are fitted on the training split and scored on the test split, one per level of the tower: logistic regression or
boosted trees on U of the block itself, and boosted trees on U of all three blocks, all that CoPhyNet takes along to C, and their
offsets in A. The second table blurs AB by independent Gaussian noise and gives the MSE of D. For runs at size=small, whose data
lie in data_dir; half a minute on one core.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from sklearn.base import ClassifierMixin
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from torch import Tensor, nn
from tqdm import tqdm

from cophy.config import folder, settings
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.dataset.source import generated_sets
from cophy.schemas import SCENARIOS, register
from cophy.training.metrics import mean_squared_error
from cophy.training.probe import collect_estimates
from cophy.training.trained import TrainedPredictor
from cophy.types import Batch

NUM_BLOCKS = 3
NOISE_M = (0.0, 0.001, 0.01, 0.05, 0.1)


class Blocks(NamedTuple):
    """Three blocks of each experiment, from bottom to top.

    Attributes:
        u: (experiment, 3, H) their U.
        offset: (experiment, 3, 3) offsets in A from the lowest, metres.
        classes: (experiment, 3, 2) of mass and friction.
        falls: (experiment,) whether A falls.
    """

    u: Tensor
    offset: Tensor
    classes: Tensor
    falls: Tensor


def main(run: Path, data_dir: Path) -> None:
    """Print both tables."""
    register()
    chosen = settings("train", "scenario=blocktower", "split=3to3")
    (towers,) = generated_sets(
        chosen.scenario, chosen.split, None, size=chosen.size, data_seed=chosen.data_seed, data_dir=data_dir
    )
    data = CounterfactualDataModule(
        chosen.split, train_set=towers, test_set=towers, batch_size=chosen.training.batch_size, workers=1
    )
    data.setup()
    network = TrainedPredictor(run / "checkpoints" / "best.ckpt", SCENARIOS).network
    Console().print(contents(network, data.train.batch, data.test.batch))
    Console().print(blurred(network, data.test.batch))


def contents(network: nn.Module, train: Batch, test: Batch) -> Table:
    """Accuracies in %, for all towers and for those whose A falls or stands.

    Args:
        network: From `Inputs` to `Prediction`, with an estimate U.
        train: What the classifiers are fitted on.
        test: What they are scored on.
    """
    table = Table("classifier", "sees", "A", "test blocks", "mass, %", "friction, %", "both (4-way), %")
    parts = [_from_bottom_to_top(network, batch) for batch in (train, test)]
    kinds = (("linear", False), ("trees", False), ("trees", True))
    for (kind, whole), name in tqdm(list(product(kinds, ("all", "falls", "stands"))), unit="probe"):
        train_group, test_group = (_group(part, name, whole=whole) for part in parts)
        right = _right(kind, train_group, test_group)
        shares = [f"{100 * r.mean():.0f}" for r in (right[:, 0], right[:, 1], right.all(axis=1))]
        table.add_row(kind, "all U, A" if whole else "its U", name, str(right[:, 0].size), *shares)
    return table


def blurred(network: nn.Module, test: Batch) -> Table:
    """MSE of D where AB is seen with noise; C is seen as it is."""
    table, inputs = Table("noise of AB, m", "MSE"), test.inputs
    for noise_m in NOISE_M:
        noise = noise_m * torch.randn(inputs.observed.shape, generator=torch.Generator().manual_seed(0))
        observed = inputs.observed + noise * inputs.observed_presence[:, None, :, None]
        with torch.no_grad():
            prediction = network(replace(inputs, observed=observed))
        table.add_row(f"{noise_m:g}", f"{mean_squared_error(dims=3)(prediction, test.targets).mean():.3f}")
    return table


def _from_bottom_to_top(network: nn.Module, batch: Batch) -> Blocks:
    inputs = batch.inputs
    u = collect_estimates(network, inputs, batch_size=256)
    assert u is not None, "this model makes no estimate U"
    height = inputs.observed[:, 0, :, 2].masked_fill(~inputs.observed_presence, torch.inf)
    order = height.argsort(dim=1)[:, :NUM_BLOCKS, None]
    u, first, classes = (
        tensor.gather(1, order.expand(-1, -1, tensor.shape[-1]))
        for tensor in (u, inputs.observed[:, 0], batch.targets.confounder_class)
    )
    falls = (~inputs.observed_stable.all(dim=1) & inputs.observed_presence).any(dim=1)
    return Blocks(u, first - first[:, :1], classes, falls)


def _group(blocks: Blocks, name: str, *, whole: bool) -> tuple[np.ndarray, np.ndarray]:
    """(3, n, features) and classes (3, n, 2) of the experiments of a group."""
    falls = blocks.falls
    chosen = {"all": torch.ones_like(falls), "falls": falls, "stands": ~falls}[name]
    tower = torch.cat([blocks.u.flatten(1), blocks.offset.flatten(1)], dim=1)[:, None].expand(-1, NUM_BLOCKS, -1)
    features = tower if whole else blocks.u
    return features[chosen].transpose(0, 1).numpy(), blocks.classes[chosen].transpose(0, 1).numpy()


def _right(kind: str, train: tuple[np.ndarray, np.ndarray], test: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(block, confounder, experiment) bool: what a classifier, fitted on `train`, says rightly of `test`."""
    (seen, classes), (asked, truth) = train, test

    def answers(block: int, confounder: int) -> np.ndarray:
        classifier = _classifier(kind).fit(seen[block], classes[block, :, confounder])
        return np.asarray(classifier.predict(asked[block]) == truth[block, :, confounder])

    return np.stack([[answers(block, confounder) for confounder in (0, 1)] for block in range(NUM_BLOCKS)])


def _classifier(kind: str) -> ClassifierMixin:
    if kind == "linear":
        return make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000))
    return HistGradientBoostingClassifier(random_state=0)


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of a trained CoPhyNet")
    parser.add_argument(
        "data_dir", nargs="?", type=Path, default=Path(folder("COPHY_DATA")), help="where the dataset lies"
    )
    main(**vars(parser.parse_args()))
