"""How well idealised physics predicts balls, by what it knows: python benchmarks/results/idealised_balls.py [data_dir]

D of four balls is computed by an idealised physics: spheres that slide and then roll on a floor, elastic impacts with Coulomb
friction, frictionless walls, and at most one impact of a pair in each part of a frame. It starts from the true positions, velocities,
masses and frictions, or without some of them. Test split of size=small, data seed 0.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import cophy
from cophy.config import folder
from cophy.scenario.balls import Balls
from cophy.scoring import Predictions

ROLL = 2.5  # mass times squared radius over moment of inertia, of a solid sphere
TINY = 1e-12
DRAWS = 16  # of masses that nobody knows
TOLERANCE = 0.01  # of a velocity: as a share, and in metres per frame
MAX_CORRECTION = 0.2  # metres per frame, of an initial velocity in an iteration


@dataclass
class Spheres:
    """Balls at t = 0 in metres and frames. Arrays: (experiment, ball, xy) or (experiment, ball)."""

    position: np.ndarray
    velocity: np.ndarray
    mass: np.ndarray
    friction: np.ndarray
    presence: np.ndarray


@dataclass(frozen=True)
class Arena:
    """Constants of the scenario in metres and frames."""

    half_width: float
    radius: float
    gravity: float
    frames: int

    def roll_out(self, balls: Spheres, parts: int, frames: int | None = None) -> np.ndarray:
        """Return (experiment, frame, ball, xy) positions in all frames after the first."""
        position, velocity = balls.position, balls.velocity
        # `rolling` is the velocity at which a ball with this angular velocity would roll; `spin` is about the vertical axis
        rolling, spin, duration = np.zeros_like(velocity), np.zeros(velocity.shape[:2]), 1 / parts
        grip, present = balls.friction[:, :, None] * balls.friction[:, None], balls.presence
        pairs = present[:, :, None] & present[:, None] & ~np.eye(present.shape[1], dtype=bool)
        share = balls.mass[:, None] / np.maximum(balls.mass[:, :, None] + balls.mass[:, None], TINY)
        frame = []
        for part in range((frames or self.frames - 1) * parts):
            slip = velocity - rolling
            speed = np.linalg.norm(slip, axis=-1, keepdims=True)
            deceleration = self.gravity * balls.friction[..., None]
            sliding = np.minimum(speed / np.maximum(deceleration * (1 + ROLL), TINY), duration)  # time until it rolls
            change = slip / np.maximum(speed, TINY) * deceleration * sliding
            mean = velocity - change * (1 - sliding / (2 * duration))
            rolling = rolling + ROLL * change
            offset, relative = (each[:, None] - each[:, :, None] for each in (position, mean))
            a, b = (np.square(relative).sum(-1) + TINY), (offset * relative).sum(-1)
            root = b**2 - a * (np.square(offset).sum(-1) - (2 * self.radius) ** 2)
            moment = np.maximum((-b - np.sqrt(np.maximum(root, 0))) / a, 0)
            hit = pairs & (root > 0) & (b < 0) & (moment < duration)
            normal = offset + moment[..., None] * relative
            normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), TINY)
            tangent = np.stack([-normal[..., 1], normal[..., 0]], axis=-1)
            approach = (relative * normal).sum(-1)
            sideways = (relative * tangent).sum(-1) - self._sum(spin)
            upwards = (self._sum(rolling) * normal).sum(-1)
            surface = np.maximum(np.hypot(sideways, upwards), TINY)
            held = share * hit * np.minimum(surface / (1 + ROLL), -2 * grip * approach) / surface
            impulse = (2 * approach * share * hit)[..., None] * normal + (held * sideways)[..., None] * tangent
            position = position + duration * mean + ((duration - moment)[..., None] * impulse).sum(axis=2)
            velocity = velocity - change + impulse.sum(axis=2)
            rolling = rolling - ROLL * ((held * upwards)[..., None] * normal).sum(axis=2)
            spin = spin + ROLL * (held * sideways).sum(axis=2)
            beyond = np.abs(position) - (self.half_width - self.radius)
            bounces = (beyond > 0) & (position * velocity > 0)
            position = position - 2 * np.where(bounces, beyond * np.sign(position), 0)
            velocity = np.where(bounces, -velocity, velocity)
            if part % parts == parts - 1:
                frame.append(position)
        return np.stack(frame, axis=1)

    @staticmethod
    def _sum(each: np.ndarray) -> np.ndarray:
        return each[:, None] + each[:, :, None]


def main(data_dir: Path) -> None:
    """Print a line for each kind of knowledge."""
    data = cophy.load("balls", split="test", data_dir=data_dir)
    scenario, arrays = data.scenario, data.arrays
    assert isinstance(scenario, Balls)
    clock = scenario.clock
    frame, every = 1 / clock.frame_rate_hz, round(clock.state_rate_hz / clock.frame_rate_hz)
    states = arrays["states"][:, :, ::every].astype(np.float64)
    arena = Arena(
        scenario.arena_half_width, scenario.ball_diameter / 2, -scenario.gravity_z * frame**2, states.shape[2]
    )
    positions, velocity = states[..., :2], states[:, 0, 0, :, 7:9] * frame
    mass, friction = (arrays[name].astype(np.float64) for name in ("mass", "friction"))
    ab, cd = (Spheres(positions[:, k, 0], velocity, mass, friction, arrays["presence"][:, k]) for k in range(2))
    truth = cophy.load_truth("balls", split="4to4", data_dir=data_dir)
    table = Table("known besides C", "impacts per frame", "MSE, m²", "95 % interval", "twins, %")

    def add(name: str, parts: int, predicted: np.ndarray) -> None:
        height = np.full((*predicted.shape[:-1], 1), arena.radius)
        scores = cophy.score(Predictions(data.rows, np.concatenate([predicted, height], axis=-1)), truth)
        low, high = scores.intervals()["mse"]
        twins = scores.means()["twin_difference_explained"]
        table.add_row(name, str(parts), f"{scores.means()['mse']:.3f}", f"{low:.3f}, {high:.3f}", f"{100 * twins:.0f}")

    for parts in (1, 2, 4, 8):
        add("everything", parts, arena.roll_out(cd, parts))
    unknown_friction = np.where(cd.presence, np.mean(scenario.confounders.friction), 0)
    add("all but the frictions: their mean", 4, arena.roll_out(replace(cd, friction=unknown_friction), 4))
    add("all but the masses: equal", 4, arena.roll_out(replace(cd, mass=np.ones_like(cd.mass)), 4))
    rng = np.random.default_rng(0)
    drawn = (rng.choice(scenario.confounders.mass, cd.mass.shape) for _ in range(DRAWS))
    guesses = [arena.roll_out(replace(cd, mass=mass), 4) for mass in drawn]
    add(f"all but the masses: mean of D over {DRAWS} draws", 4, np.mean(guesses, axis=0))
    motion = positions[:, 0, 1] - positions[:, 0, 0]
    read = motion
    for _ in range(4):
        reached = arena.roll_out(replace(ab, velocity=read), 4, frames=1)[:, 0] - ab.position
        read = read + np.clip(motion - reached, -MAX_CORRECTION, MAX_CORRECTION)
    add("all but the initial velocities: from the first frame of AB", 4, arena.roll_out(replace(cd, velocity=read), 4))
    # the floor slows a ball that touches nothing else to between 5/7 and all of its velocity, in the same direction
    after = states[:, 0, 1, :, 7:9] * frame
    kept = (after * velocity).sum(-1) / np.maximum(np.square(velocity).sum(-1), TINY)
    aside = np.linalg.norm(after - kept[..., None] * velocity, axis=-1)
    touched = (kept < 5 / 7 - TOLERANCE) | (kept > 1 + TOLERANCE) | (aside > TOLERANCE)
    corrected = replace(cd, velocity=np.where(touched[..., None], velocity, read))
    add("the same, but true where a ball touches something in it", 4, arena.roll_out(corrected, 4))
    Console(width=120).print(table)
    print(f"{touched[ab.presence].mean():.0%} of the balls touch another or a wall in the first frame of AB")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument(
        "data_dir", nargs="?", type=Path, default=Path(folder("COPHY_DATA")), help="where the dataset lies"
    )
    main(**vars(parser.parse_args()))
