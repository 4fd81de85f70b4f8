"""How well idealised physics predicts balls, by what it knows: python benchmarks/results/idealised_balls.py [--data-dir FOLDER]

D of four balls is computed by the idealised physics of cophy.models.spheres. It starts from the true positions, velocities, masses and
frictions, or without some of them. Test split of size=small, data seed 0.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

import cophy
from cophy.config import folder
from cophy.models.spheres import TINY, Arena, Spheres
from cophy.scenario.balls import Balls
from cophy.scoring import Predictions

DRAWS = 16  # of masses that nobody knows
TOLERANCE = 0.01  # of a velocity: as a share, and in metres per frame
MAX_CORRECTION = 0.2  # metres per frame, of an initial velocity in an iteration


def main(data_dir: Path) -> None:
    """Print a line for each kind of knowledge."""
    data = cophy.load("balls", split="test", data_dir=data_dir)
    scenario, arrays = data.scenario, data.arrays
    assert isinstance(scenario, Balls)
    clock = scenario.clock
    frame = 1 / clock.frame_rate_hz
    states = torch.from_numpy(arrays["states"][:, :, :: clock.states_per_frame]).double()
    gravity, frames = -scenario.gravity_z * frame**2, states.shape[2] - 1
    arenas = {
        parts: Arena(scenario.arena_half_width, scenario.ball_diameter / 2, gravity, parts) for parts in (1, 2, 4, 8)
    }
    positions, velocity = states[..., :2], states[:, 0, 0, :, 7:9] * frame
    mass, friction = (torch.from_numpy(arrays[name]).double() for name in ("mass", "friction"))
    presence = torch.from_numpy(arrays["presence"])
    ab, cd = (Spheres(positions[:, k, 0], velocity, mass, friction, presence[:, k]) for k in range(2))
    truth = cophy.load_truth("balls", split="4to4", data_dir=data_dir)
    table = Table("known besides C", "impacts per frame", "MSE, m²", "95 % interval", "twins, %")

    def add(name: str, *guesses: Spheres, parts: int = 4) -> None:
        """Add the line of a mean over guesses."""
        predicted = torch.stack([arenas[parts].roll_out(balls, frames) for balls in guesses]).mean(dim=0).numpy()
        height = np.full((*predicted.shape[:-1], 1), scenario.ball_diameter / 2)
        scores = cophy.score(Predictions(data.rows, np.concatenate([predicted, height], axis=-1)), truth)
        low, high = scores.intervals()["mse"]
        twins = scores.means()["twin_difference_explained"]
        table.add_row(name, str(parts), f"{scores.means()['mse']:.3f}", f"{low:.3f}, {high:.3f}", f"{100 * twins:.0f}")

    for parts in arenas:
        add("everything", cd, parts=parts)
    mean_friction = torch.where(cd.presence, float(np.mean(scenario.confounders.friction)), 0.0).double()
    add("all but the frictions: their mean", replace(cd, friction=mean_friction))
    add("all but the masses: equal", replace(cd, mass=torch.ones_like(cd.mass)))
    rng = np.random.default_rng(0)
    drawn = [torch.from_numpy(rng.choice(scenario.confounders.mass, cd.mass.shape)).double() for _ in range(DRAWS)]
    add(f"all but the masses: mean of D over {DRAWS} draws", *(replace(cd, mass=mass) for mass in drawn))
    read = velocities_of_first_frame(ab, positions[:, 0, 1], arenas[4])
    add("all but the initial velocities: from the first frame of AB", replace(cd, velocity=read))
    # the floor slows a ball that touches nothing else to between 5/7 and all of its velocity, in the same direction
    after = states[:, 0, 1, :, 7:9] * frame
    share_kept = (after * velocity).sum(-1) / velocity.square().sum(-1).clamp(min=TINY)
    aside = (after - share_kept[..., None] * velocity).norm(dim=-1)
    touched = (share_kept < 5 / 7 - TOLERANCE) | (share_kept > 1 + TOLERANCE) | (aside > TOLERANCE)
    corrected = replace(cd, velocity=torch.where(touched[..., None], velocity, read))
    add("the same, but true where a ball touches something in it", corrected)
    Console(width=120).print(table)
    print(f"{touched[ab.presence].double().mean():.0%} of the balls touch another or a wall in the first frame of AB")


def velocities_of_first_frame(ab: Spheres, reached: Tensor, arena: Arena) -> Tensor:
    """Return the initial velocities with which balls reach their positions in the next frame, if they touch nothing."""
    motion = read = reached - ab.position
    for _ in range(4):
        error = reached - arena.roll_out(replace(ab, velocity=read), 1)[:, 0]
        read = read + error.clamp(-MAX_CORRECTION, MAX_CORRECTION)
    return torch.where(ab.presence[..., None], read, motion)


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--data-dir", type=Path, default=Path(folder("COPHY_DATA")), help="where the dataset lies")
    main(**vars(parser.parse_args()))
