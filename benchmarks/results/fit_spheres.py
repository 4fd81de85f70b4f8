"""What fitting spheres to AB finds out: python benchmarks/results/fit_spheres.py [--num-objects K] [--data-dir FOLDER]

Prints how often model=spheres finds masses and frictions, and the energy score of its draws of D next to the MSE of their mean. Test
split of size=small, data seed 0; two CPU-seconds per experiment of four balls.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import numpy as np
import torch
from hydra.utils import instantiate
from rich.progress import track

import cophy
from cophy.config import composed, folder
from cophy.models import FittedSpheres
from cophy.scoring import Predictions

SAMPLES = 32  # draws of each experiment that are scored
MEASURES = {
    "mse": "MSE of the mean, m²",
    "energy_score": "energy score, m",
    "best_sample_mse": "MSE of the best draw, m²",
}


def main(num_objects: int, data_dir: Path) -> None:
    """Fit every test experiment; print the scores and the share of balls whose mass and friction are right."""
    torch.set_num_threads(1)  # tensors are small
    config = composed("train", "scenario=balls", f"split=4to{num_objects}", "model=spheres")
    model = instantiate(config.model)
    assert isinstance(model, FittedSpheres)
    data = cophy.load("balls", split="test", num_objects=num_objects, data_dir=data_dir)
    states = data.arrays["states"][:, :, :: data.scenario.clock.states_per_frame]
    positions = torch.from_numpy(states[..., :3]).double()
    presence = torch.from_numpy(data.arrays["presence"])
    values = {name: torch.from_numpy(data.arrays[name]) for name in ("mass", "friction")}
    samples, right = np.empty((len(positions), SAMPLES, *positions[0, 1, 1:].shape), dtype=np.float32), []
    for row in track(range(len(positions)), "fitting"):
        slots = presence[row, 0].nonzero()[:, 0]
        observed, initial = positions[row, 0][:, slots, :2], positions[row, 1, 0][slots, :2]
        combinations, evidence = model.weigh_hypotheses(observed, torch.Generator().manual_seed(0))
        for index, name in enumerate(values):
            candidates, true = combinations[..., index], values[name][row, slots]
            weight = (evidence.softmax(dim=0)[:, None] * torch.isclose(candidates, true.double())).sum(dim=0)
            right.append((name, (weight > 0.5).double().mean().item()))
        draws = model.draw_outcomes(observed, initial, presence[row, 1, slots])
        chosen = draws[torch.linspace(0, len(draws) - 1, SAMPLES).long()]  # draws are in no order
        samples[row] = positions[row, 1, :1].expand(*samples[row].shape)
        samples[row, :, :, slots.numpy(), :2] = chosen.movedim(2, 0).numpy()
    for name in values:
        print(f"{name}: right for {np.mean([share for each, share in right if each == name]):.1%} of the balls")
    truth = cophy.load_truth("balls", split=f"4to{num_objects}", data_dir=data_dir)
    scores = cophy.score(Predictions(data.rows, samples.mean(axis=1), samples=samples), truth)
    means, intervals = scores.means(), scores.intervals()
    for name, title in MEASURES.items():
        print(f"{title}: {means[name]:.3f} [{intervals[name][0]:.3f}, {intervals[name][1]:.3f}]")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--num-objects", type=int, default=4, help="balls in an experiment (default: 4)")
    parser.add_argument("--data-dir", type=Path, default=Path(folder("COPHY_DATA")), help="where the dataset lies")
    main(**vars(parser.parse_args()))
