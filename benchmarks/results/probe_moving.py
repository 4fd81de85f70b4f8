"""The probe of Table 5 in collisions, asked of the moving and of the resting objects apart:

    python benchmarks/results/probe_moving.py checkpoints/collision_all_cophynet.ckpt [data_dir]

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
from cophy.training.probe import Probed, collect_estimates, probe
from cophy.training.trained import TrainedPredictor
from cophy.types import Batch

ASKED = {"probe_accuracy": "both", "probe_mass_accuracy": "mass", "probe_friction_accuracy": "friction"}


def main(checkpoint: Path, data_dir: Path) -> None:
    """Print a line for each kind of object."""
    register()
    predictor = TrainedPredictor(checkpoint, SCENARIOS)
    keys = ("scenario=collision", "split=all", f"size={predictor.size}", f"data_seed={predictor.data_seed}")
    chosen = settings("train", *keys)
    (collisions,) = generated_by(replace(chosen, data_dir=str(data_dir)))
    data = CounterfactualDataModule(
        chosen.split, train_set=collisions, test_set=collisions, batch_size=chosen.training.batch_size, workers=1
    )
    data.setup()
    train, test = (of_each_kind(predictor, split.batch) for split in (data.train, data.test))
    pairs = data.test.batch.targets.pair.numpy()
    table = Table("objects", *(f"{name}, %" for name in ASKED.values()), "chance of both, %")
    for kind in train:
        found = probe(train[kind], test[kind])
        cells = [f"{100 * mean(found[name]):.1f} {percent(*interval(found[name], pairs))}" for name in ASKED]
        table.add_row(kind, *cells, f"{100 * mean(found['probe_chance']):.1f}")
    Console(width=120).print(table)


def of_each_kind(predictor: TrainedPredictor, batch: Batch) -> dict[str, Probed]:
    """U, and the truth about all objects, those that move at the start of AB, and those at rest."""
    u = collect_estimates(predictor.network, batch.inputs, batch_size=256)
    assert u is not None, "this model makes no estimate U"
    presence = batch.targets.observed_presence
    gone = (batch.inputs.observed[:, 1] - batch.inputs.observed[:, 0]).norm(dim=-1).masked_fill(~presence, -1.0)
    moving = torch.zeros_like(presence).scatter(1, gone.argmax(dim=1, keepdim=True), True)
    kinds = {"all": presence, "moving": moving, "at rest": presence & ~moving}
    return {name: Probed(u, replace(batch.targets, observed_presence=mask)) for name, mask in kinds.items()}


def percent(low: float, high: float) -> str:
    """An interval, as the pages have it."""
    return f"[{100 * low:.1f}, {100 * high:.1f}]"


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path, help="of a CoPhyNet that was trained on collisions")
    parser.add_argument(
        "data_dir", nargs="?", type=Path, default=Path(folder("COPHY_DATA")), help="where the dataset lies"
    )
    main(**vars(parser.parse_args()))
