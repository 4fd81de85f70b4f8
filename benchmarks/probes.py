"""What U of a trained CoPhyNet holds about masses and frictions of towers of three, asked in other ways than Table 5 asks:

    python benchmarks/probes.py outputs/blocktower/3to3/cophynet/full/ground_truth/seed0 [data_dir]

Classifiers are fitted on the training split and scored on the test split, one per level of the tower: logistic regression or
boosted trees on U of the block itself, and boosted trees on U of all three blocks, all that CoPhyNet takes along to C, and their
offsets in A. The second table blurs AB by independent Gaussian noise and gives the MSE of D. For runs at size=small, whose data
lie in data_dir; half a minute on one core.
"""

import sys
from itertools import product
from pathlib import Path

import numpy as np
import torch
from measure import settings
from rich.console import Console
from rich.table import Table
from sklearn.base import ClassifierMixin
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from torch import Tensor, nn
from tqdm import tqdm

from cophy import config
from cophy.dataset.datamodule import CounterfactualDataModule
from cophy.training.inference import TrainedPredictor
from cophy.training.metrics import mean_squared_error
from cophy.training.probe import estimate
from cophy.types import Batch

NUM_BLOCKS = 3
NOISE_M = (0.0, 0.001, 0.01, 0.05, 0.1)


def main(run: Path, data_dir: Path) -> None:
    """Print both tables."""
    config.register()
    chosen = settings("train", "scenario=blocktower", "split=3to3")
    data = CounterfactualDataModule(
        scenario=chosen.scenario,
        split=chosen.split,
        size=chosen.size,
        seed=0,
        data_dir=data_dir,
        source=chosen.source,
        batch_size=chosen.training.batch_size,
        workers=1,
    )
    data.setup()
    network = TrainedPredictor(run / "checkpoints" / "best.ckpt").network
    Console().print(probes(network, data.train.batch, data.test.batch))
    Console().print(blurred(network, data.test.batch))


def probes(network: nn.Module, train: Batch, test: Batch) -> Table:
    """Accuracies in %, for all towers and for those whose A falls or stands."""
    table = Table("classifier", "sees", "A", "test blocks", "mass, %", "friction, %", "both (4-way), %")
    parts = [_from_bottom_to_top(network, batch) for batch in (train, test)]
    kinds = (("linear", False), ("trees", False), ("trees", True))
    for (kind, whole), name in tqdm(list(product(kinds, ("all", "falls", "stands"))), unit="probe"):
        (seen, classes), (asked, truth) = (_group(*part, name, whole=whole) for part in parts)
        right = np.stack(
            [
                [_classifier(kind).fit(seen[k], classes[k, :, c]).predict(asked[k]) == truth[k, :, c] for c in (0, 1)]
                for k in range(NUM_BLOCKS)
            ]
        )  # block, confounder, experiment
        shares = [f"{100 * r.mean():.0f}" for r in (right[:, 0], right[:, 1], right.all(axis=1))]
        table.add_row(kind, "all U, A" if whole else "its U", name, str(right[:, 0].size), *shares)
    return table


def blurred(network: nn.Module, test: Batch) -> Table:
    """MSE of D where AB is seen with noise; C is seen as it is."""
    table = Table("noise of AB, m", "MSE")
    for noise_m in NOISE_M:
        noise = noise_m * torch.randn(test.observed.shape, generator=torch.Generator().manual_seed(0))
        observed = test.observed + noise * test.observed_presence[:, None, :, None]
        with torch.no_grad():
            prediction = network(test._replace(observed=observed))
        table.add_row(f"{noise_m:g}", f"{mean_squared_error(dims=3)(prediction, test).mean():.3f}")
    return table


def _from_bottom_to_top(network: nn.Module, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """U (N, 3, H), offsets in A (N, 3, 3), classes of mass and friction (N, 3, 2), and whether A falls (N,)."""
    u = estimate(network, batch, batch_size=256)
    assert u is not None, "this model makes no estimate U"
    height = batch.observed[:, 0, :, 2].masked_fill(~batch.observed_presence, torch.inf)
    order = height.argsort(dim=1)[:, :NUM_BLOCKS, None]
    u, first, classes = (
        tensor.gather(1, order.expand(-1, -1, tensor.shape[-1]))
        for tensor in (u, batch.observed[:, 0], batch.confounder_class)
    )
    falls = (~batch.observed_stable.all(dim=1) & batch.observed_presence).any(dim=1)
    return u, first - first[:, :1], classes, falls


def _group(
    u: Tensor, offset: Tensor, classes: Tensor, falls: Tensor, name: str, *, whole: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(3, n, features) and (3, n, 2) of the experiments of a group."""
    chosen = {"all": torch.ones_like(falls), "falls": falls, "stands": ~falls}[name]
    context = torch.cat([u.flatten(1), offset.flatten(1)], dim=1)[:, None].expand(-1, NUM_BLOCKS, -1)
    features = context if whole else u
    return features[chosen].transpose(0, 1).numpy(), classes[chosen].transpose(0, 1).numpy()


def _classifier(kind: str) -> ClassifierMixin:
    if kind == "linear":
        return make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000))
    return HistGradientBoostingClassifier(random_state=0)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else "data"))
