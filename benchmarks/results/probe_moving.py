"""The probe of Table 5 in collisions, asked of the moving and of the resting objects apart:

    python benchmarks/results/probe_moving.py checkpoints/collision_all_cophynet.ckpt [--data-dir FOLDER]

At the start of AB one object moves and the other rests. The one that goes farther until the second frame is the moving one.
Classifiers are fitted on the training split and scored on the test split, of the size that the model was trained on.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from dataclasses import replace
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from cophy.bootstrap import interval, mean
from cophy.config import folder, generated_by, settings
from cophy.dataset.datamodules import CounterfactualDataModule
from cophy.schemas import SCENARIOS, register
from cophy.training.probe import Probed, collect_estimates, probe, probe_accuracies
from cophy.training.trained import TrainedPredictor
from cophy.types import Batch

ACCURACIES = {"probe_accuracy": "both", "probe_mass_accuracy": "mass", "probe_friction_accuracy": "friction"}


def main(checkpoint: Path, data_dir: Path) -> None:
    """Print a line for each kind of object."""
    register()
    predictor = TrainedPredictor(checkpoint, SCENARIOS)
    keys = ("scenario=collision", "split=all", f"size={predictor.size}", f"data_seed={predictor.data_seed}")
    config = settings("train", *keys)
    (collisions,) = generated_by(replace(config, data_dir=str(data_dir)))
    data = CounterfactualDataModule(
        config.split, train_set=collisions, test_set=collisions, batch_size=config.training.batch_size, workers=1
    )
    data.setup()
    train, test = (probed_by_kind(predictor, split.batch) for split in (data.train, data.test))
    clusters = collisions.clusters(data.test_experiments)
    table = Table("objects", *(f"{name}, %" for name in ACCURACIES.values()), "chance of both, %")
    for kind in train:
        accuracies = probe_accuracies(probe(train[kind], test[kind]))
        cells = [
            f"{100 * mean(accuracies[name]):.1f} {percent(*interval(accuracies[name], clusters))}"
            for name in ACCURACIES
        ]
        table.add_row(kind, *cells, f"{100 * mean(accuracies['probe_chance']):.1f}")
    Console(width=120).print(table)


def probed_by_kind(predictor: TrainedPredictor, batch: Batch) -> dict[str, Probed]:
    """U, and the truth about all objects, those that move at the start of AB, and those at rest."""
    u = collect_estimates(predictor.network, batch.inputs, batch_size=256)
    assert u is not None, "this model makes no estimate U"
    presence = batch.targets.observed_presence
    distance = (batch.inputs.observed[:, 1] - batch.inputs.observed[:, 0]).norm(dim=-1).masked_fill(~presence, -1.0)
    moving = torch.zeros_like(presence).scatter(1, distance.argmax(dim=1, keepdim=True), True)
    kinds = {"all": presence, "moving": moving, "at rest": presence & ~moving}
    return {name: Probed(u, replace(batch.targets, observed_presence=mask)) for name, mask in kinds.items()}


def percent(low: float, high: float) -> str:
    """An interval, as the pages have it."""
    return f"[{100 * low:.1f}, {100 * high:.1f}]"


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path, help="of a CoPhyNet that was trained on collisions")
    parser.add_argument("--data-dir", type=Path, default=Path(folder("COPHY_DATA")), help="where the dataset lies")
    main(**vars(parser.parse_args()))
