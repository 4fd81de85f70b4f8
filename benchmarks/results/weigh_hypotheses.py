"""What model=hypotheses reads off AB: python benchmarks/results/weigh_hypotheses.py CHECKPOINT [--num-objects K] [--data-dir FOLDER]

Prints the MSE of D with the weights that AB gives to the hypotheses, with equal weights, and with the true masses and gravity alone; and
the energy score of draws by the weights next to that of their mean. Draws do not vary within a hypothesis. Test split of size=small, data
seed 0; half a minute.
"""

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import one_hot

import cophy
from cophy.config import folder
from cophy.dataset.features import to_batch
from cophy.models import Hypotheses
from cophy.scoring import Predictions, Truth
from cophy.types import take

SAMPLES = 32  # draws of each experiment that are scored
BATCH = 50


def main(checkpoint: Path, num_objects: int, data_dir: Path) -> None:
    """Weigh the hypotheses of every test experiment, and print what the module says."""
    predictor = cophy.load_predictor(checkpoint)
    network = predictor.network
    if not isinstance(network, Hypotheses) or (predictor.size, predictor.data_seed) != ("small", 0):
        sys.exit(f"{checkpoint} is not of model=hypotheses with size=small and data_seed=0")
    data = cophy.load("blocktower", split="test", num_objects=num_objects, data_dir=data_dir)
    inputs = to_batch(data.arrays, data.scenario, ["pose"] * network.pose).inputs
    mass, tilt = network.combinations(inputs.presence.shape[1])
    true = true_hypotheses(data.arrays, inputs.observed_presence, mass, tilt)
    predictions: dict[str, list[Tensor]] = {name: [] for name in ("weighed by AB", "weighed equally", "true", "draws")}
    generator = torch.Generator().manual_seed(0)
    for start in range(0, len(inputs), BATCH):
        part = take(inputs, slice(start, start + BATCH))
        with torch.no_grad():
            weight, (position, _) = network.weigh(part).exp(), network.outcomes(part)
        index = true[start : start + BATCH]
        equal = torch.full_like(weight, 1 / weight.shape[1])
        for name, weights in zip(predictions, (weight, equal, one_hot(index, weight.shape[1]).float()), strict=False):
            predictions[name].append(torch.einsum("bh,bhtkx->btkx", weights, position))
        drawn = weight.multinomial(SAMPLES, replacement=True, generator=generator)
        predictions["draws"].append(position[torch.arange(len(part))[:, None], drawn])
    truth = cophy.load_truth("blocktower", split=f"{num_objects}to{num_objects}", data_dir=data_dir)
    *means, draws = (torch.cat(parts).numpy() for parts in predictions.values())
    for name, mean in zip(predictions, means, strict=False):
        score("MSE, m², " + name, "mse", Predictions(data.rows, mean), truth)
    score("energy score of draws, m", "energy_score", Predictions(data.rows, means[0], samples=draws), truth)
    score(
        "energy score of the mean, m",
        "energy_score",
        Predictions(data.rows, means[0], samples=means[0][:, None]),
        truth,
    )


def true_hypotheses(
    arrays: dict[str, np.ndarray],
    seen: Tensor,
    mass: Float[Tensor, "hypotheses slots"],
    tilt: Float[Tensor, "hypotheses 2"],
) -> Tensor:
    """Return for each experiment the index of the hypothesis with the true masses and direction of gravity."""
    is_heavy = torch.from_numpy(arrays["mass"] > 3) & seen  # kg: they are 1 and 10
    wrong = ((mass > 1) != is_heavy[:, None]).float()
    wrong = (wrong * seen[:, None]).sum(dim=2)
    gravity = torch.from_numpy(arrays["gravity"][:, :2]).sign()
    wrong += (tilt.sign() != gravity[:, None]).sum(dim=2)
    return wrong.argmin(dim=1)


def score(title: str, measure: str, predictions: Predictions, truth: Truth) -> None:
    """Print a mean and its interval."""
    scores = cophy.score(predictions, truth)
    low, high = scores.intervals()[measure]
    print(f"{title}: {scores.means()[measure]:.3f} [{low:.3f}, {high:.3f}]")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path, help="best.ckpt of a run of train.py with model=hypotheses")
    parser.add_argument("--num-objects", type=int, default=3, help="blocks of the towers that are tested (default: 3)")
    parser.add_argument("--data-dir", type=Path, default=Path(folder("COPHY_DATA")), help="where the datasets lie")
    main(**vars(parser.parse_args()))
