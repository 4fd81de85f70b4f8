"""How the error on collisions depends on what is hit: python benchmarks/results/lying_cylinders.py CHECKPOINT ... [--data-dir FOLDER]

Prints the test MSE of experiments in which the object that is hit is a lying cylinder, and of the others. Takes seconds.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import torch

import cophy
from cophy.config import folder
from cophy.dataset.features import poses, to_batch
from cophy.models.contacts import lying_cylinders
from cophy.training.metrics import mean_squared_error
from cophy.types import take

BATCH = 100


def main(checkpoints: list[Path], data_dir: Path) -> None:
    """Print the errors of each checkpoint."""
    for path in checkpoints:
        predictor = cophy.load_predictor(path)
        options = {"size": predictor.size, "data_seed": predictor.data_seed, "data_dir": data_dir}
        data = cophy.load("collision", split="test", **options)
        batch = to_batch(data.arrays, data.scenario, predictor.appearance)
        squared_error = mean_squared_error(data.scenario.task.metric_dims)
        parts = [take(batch, slice(start, start + BATCH)) for start in range(0, len(batch), BATCH)]
        with torch.no_grad():
            error = torch.cat([squared_error(predictor.network(part.inputs), part.targets) for part in parts])
        lies = lying_cylinders(poses(data.arrays))[0].any(dim=1)[:, 0]  # what moves never lies
        print(
            f"{path}: {error.mean():.4f} m² in {len(error)} experiments; lying cylinders ({lies.float().mean():.0%}) "
            f"{error[lies].mean():.4f}, {error[lies].sum() / error.sum():.0%} of the error; others {error[~lies].mean():.4f}"
        )


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument(
        "checkpoints", type=Path, nargs="+", help="best.ckpt of runs of train.py with scenario=collision"
    )
    parser.add_argument("--data-dir", type=Path, default=Path(folder("COPHY_DATA")), help="where the datasets lie")
    main(**vars(parser.parse_args()))
