"""Spheres: an idealised physics of balls is fitted to AB and then started from C. Nothing is trained; not in the paper.

The laws of motion are given, as are the values that masses and frictions can have. Masses, frictions and initial velocities of an
experiment are inferred from its AB:

1. Masses and frictions: under each hypothesis, every ball is followed through AB by a particle filter, which predicts a frame
   from the observed positions before it. The evidence for a hypothesis is the likelihood of AB under it.
2. Initial velocities: from many starts, least squares on the first frames under hypotheses drawn from step 1. A ball that touches
   another in the first frame has several solutions.
3. Draws of both are rolled out over more and more frames of AB, and those that agree are multiplied, with small changes.
4. D is the mean of the rollouts of the draws from C.

The physics: spheres that slide and then roll on a floor, elastic impacts with Coulomb friction and spin, frictionless walls, and at
most one impact of a pair in each part of a frame. Lengths are in metres and times in frames.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cophy.errors import CophyError
from cophy.models.layers import check_at_least, check_positive
from cophy.types import Inputs, Prediction

ROLL = 2.5  # mass times squared radius over moment of inertia, of a solid sphere
TINY = 1e-12
SPEED_AFTER_SLIDING = 1.1  # of a first guess: a ball is faster at t = 0 than on average in the first frame
JITTERS, SHARES = (0.005, 0.02, 0.1), (0.5, 0.35, 0.15)  # of a velocity between two frames, m per frame, and how often
START_JITTER = 0.35  # of an initial velocity, m per frame: a ball may touch another in the first frame
START_SHARE = 0.3  # of initial velocities with this jitter
CHANGES, CHANGE_SHARES = (0.0, 0.001, 0.003, 0.01), (0.4, 0.2, 0.2, 0.2)  # of a draw that is multiplied, m per frame
MAX_CORRECTION = 0.3  # m per frame
FIRST_FRAMES, ITERATIONS, DIFFERENCE = 2, 4, 1e-4  # of least squares: frames, steps, and m per frame for a slope
FRAMES = (4, 6, 8, 10, 12)  # up to which draws are compared with AB
DEGREES = 3.0  # exponent of the distribution of errors, t-like: the physics is wrong now and then
TEMPERATURE = 0.5  # of the weights of draws, so that few do not replace all


@dataclass
class Spheres:
    """Balls at t = 0.

    Attributes:
        position, velocity: m, m per frame.
        mass: In any unit.
        friction: Coefficient of a ball with the floor; that of two balls is the product.
        presence: Which balls are there.
    """

    position: Float[Tensor, "draw ball 2"]
    velocity: Float[Tensor, "draw ball 2"]
    mass: Float[Tensor, "draw ball"]
    friction: Float[Tensor, "draw ball"]
    presence: Bool[Tensor, "draw ball"]

    def __getitem__(self, rows: Tensor) -> "Spheres":
        return Spheres(*(value[rows] for value in vars(self).values()))


class Motion(NamedTuple):
    """State of balls: position and velocity; the velocity at which a ball with this angular velocity rolls; and spin about the
    vertical axis times the radius.
    """

    position: Float[Tensor, "draw ball 2"]
    velocity: Float[Tensor, "draw ball 2"]
    rolling: Float[Tensor, "draw ball 2"]
    spin: Float[Tensor, "draw ball"]


@dataclass(frozen=True)
class Arena:
    """The floor and its four walls.

    Attributes:
        half_width: From the centre to a wall, m.
        radius: Of every ball, m.
        gravity: m per squared frame.
        parts: Of a frame, each with at most one impact of a pair.
    """

    half_width: float
    radius: float
    gravity: float
    parts: int

    def roll_out(self, balls: Spheres, frames: int) -> Float[Tensor, "draw frame ball 2"]:
        """Return the positions in all frames after the first."""
        motion, positions = at_start(balls), []
        for _ in range(frames):
            motion = self.step(motion, balls)
            positions.append(motion.position)
        return torch.stack(positions, dim=1)

    def step(self, motion: Motion, balls: Spheres) -> Motion:
        """Return the motion one frame later."""
        position, velocity, rolling, spin = motion
        duration, deceleration = 1 / self.parts, (self.gravity * balls.friction)[..., None]
        for _ in range(self.parts):
            slip = velocity - rolling
            speed = slip.norm(dim=-1, keepdim=True)
            sliding = (speed / (deceleration * (1 + ROLL)).clamp(min=TINY)).clamp(max=duration)  # time until it rolls
            change = slip / speed.clamp(min=TINY) * deceleration * sliding
            mean = velocity - change * (1 - sliding / (2 * duration))
            velocity, rolling = velocity - change, rolling + ROLL * change
            moved = Motion(position + duration * mean, velocity, rolling, spin)
            position, velocity, rolling, spin = self._after_impacts(position, mean, moved, balls, duration)
            beyond = position.abs() - (self.half_width - self.radius)
            bounces = (beyond > 0) & (position * velocity > 0)
            position = position - 2 * torch.where(bounces, beyond * position.sign(), 0.0)
            velocity = torch.where(bounces, -velocity, velocity)
        return Motion(position, velocity, rolling, spin)

    def _after_impacts(
        self, before: Float[Tensor, "draw ball 2"], mean: Float[Tensor, "draw ball 2"],
        moved: Motion, balls: Spheres, duration: float,
    ) -> Motion:  # fmt: skip
        """Return the motion after a part of a frame, given that without impacts; `mean` is the mean velocity in it."""
        offset, relative = (each[:, None] - each[:, :, None] for each in (before, mean))
        a, b = relative.square().sum(-1) + TINY, (offset * relative).sum(-1)
        root = b.square() - a * (offset.square().sum(-1) - (2 * self.radius) ** 2)
        moment = ((-b - root.clamp(min=0).sqrt()) / a).clamp(min=0)
        hit = (root > 0) & (b < 0) & (moment < duration) & balls.presence[:, :, None] & balls.presence[:, None]
        rows = hit.flatten(1).any(dim=1).nonzero()[:, 0]  # impacts are rare
        if not len(rows):
            return moved
        offset, relative, moment, hit = offset[rows], relative[rows], moment[rows, ..., None], hit[rows]
        mass, friction, rolling, spin = balls.mass[rows], balls.friction[rows], moved.rolling[rows], moved.spin[rows]
        normal = offset + moment * relative
        normal = normal / normal.norm(dim=-1, keepdim=True).clamp(min=TINY)
        tangent = torch.stack([-normal[..., 1], normal[..., 0]], dim=-1)
        approach = (relative * normal).sum(-1)
        sideways = (relative * tangent).sum(-1) - _both(spin)
        upwards = (_both(rolling) * normal).sum(-1)
        surface = torch.hypot(sideways, upwards).clamp(min=TINY)
        share = mass[:, None] / (mass[:, :, None] + mass[:, None]).clamp(min=TINY) * hit
        grip = friction[:, :, None] * friction[:, None]
        held = share * torch.minimum(surface / (1 + ROLL), -2 * grip * approach) / surface
        impulse = (2 * approach * share)[..., None] * normal + (held * sideways)[..., None] * tangent
        changes = Motion(
            ((duration - moment) * impulse).sum(dim=2),
            impulse.sum(dim=2),
            -ROLL * ((held * upwards)[..., None] * normal).sum(dim=2),
            ROLL * (held * sideways).sum(dim=2),
        )
        return Motion(*(value.index_add(0, rows, change) for value, change in zip(moved, changes, strict=True)))


def at_start(balls: Spheres) -> Motion:
    """Return the motion at t = 0: no ball rotates."""
    return Motion(balls.position, balls.velocity, torch.zeros_like(balls.velocity), torch.zeros_like(balls.mass))


def _both(each: Float[Tensor, "draw ball *xy"]) -> Float[Tensor, "draw ball ball *xy"]:
    return each[:, None] + each[:, :, None]


class FittedSpheres(nn.Module):
    """Fits the physics to AB of each experiment, and rolls it out from C.

    Args:
        diameter: Of every ball, m; None in a scenario without balls.
        arena_half_width: From the centre to a wall, m; None without walls.
        gravity_z: m/s².
        frame_rate_hz: Of AB and D.
        mass, friction, restitution: The values that a ball can have; restitution must be 1.
        impacts: Impacts of a pair in a frame.
        hypotheses: Combinations of masses and frictions in a round; all of them if they are fewer.
        followers: Particles of the filter under each hypothesis.
        draws: Draws of masses, frictions and velocities.
        error: Typical error of the physics in a frame, m.

    Raises:
        CophyError: The scenario is another one, or an argument is out of its range.
    """

    def __init__(
        self,
        *,
        diameter: float | None,
        arena_half_width: float | None,
        gravity_z: float,
        frame_rate_hz: float,
        mass: list[float],
        friction: list[float],
        restitution: list[float],
        impacts: int,
        hypotheses: int,
        followers: int,
        draws: int,
        error: float,
    ) -> None:
        super().__init__()
        if diameter is None or arena_half_width is None:
            raise CophyError("model=spheres: it needs balls between walls, so use scenario=balls")
        if restitution != [1]:
            raise CophyError("model=spheres: it needs elastic balls, so use confounders=text")
        check_at_least(1, impacts=impacts, hypotheses=hypotheses, followers=followers, draws=draws)
        check_positive(diameter=diameter, arena_half_width=arena_half_width, frame_rate_hz=frame_rate_hz, error=error)
        self.arena = Arena(arena_half_width, diameter / 2, -gravity_z / frame_rate_hz**2, impacts)
        self.values = torch.tensor(list(product(mass, friction)), dtype=torch.float64)  # of a ball
        self.hypotheses, self.followers, self.draws, self.error = hypotheses, followers, draws, error

    def forward(self, inputs: Inputs) -> Prediction:
        """Fit each experiment by itself, and return the mean of D over draws."""
        position = inputs.initial[:, None].repeat(1, inputs.num_steps, 1, 1)
        for row, seen in enumerate(inputs.observed_presence & inputs.presence.any(dim=1, keepdim=True)):
            slots = seen.nonzero()[:, 0]
            if len(slots):
                observed = inputs.observed[row, :, slots, :2].double().cpu()
                initial, present = inputs.initial[row, slots, :2].double().cpu(), inputs.presence[row, slots].cpu()
                outcome = self.draw_outcomes(observed, initial, present).mean(dim=0).to(position)
                position[row, :, slots, :2] = torch.where(
                    present[:, None].to(position.device), outcome, initial.to(position)
                )
        return Prediction(position)

    def draw_outcomes(
        self, observed: Float[Tensor, "time ball 2"], initial: Float[Tensor, "ball 2"], present: Bool[Tensor, "ball"]
    ) -> Float[Tensor, "draw steps ball 2"]:
        """Return draws of D of one experiment, given AB, and C and who is in it; double precision, on the CPU."""
        random = torch.Generator().manual_seed(0)  # the same for every experiment, whatever else is in the batch
        values, evidence = self.weigh_hypotheses(observed, random)
        rows = evidence.softmax(dim=0).multinomial(self.draws, replacement=True, generator=random)
        mass, friction = values[rows].unbind(dim=-1)
        start = observed[:1].expand(self.draws, -1, -1)
        balls = Spheres(start, torch.zeros_like(start), mass, friction, torch.ones_like(mass, dtype=torch.bool))
        balls = self._fit_velocities(balls, observed, random)
        for frames in FRAMES:
            balls = self._resample(balls, self._misfit(balls, observed, frames), random)
            changes = _choice(CHANGES, CHANGE_SHARES, balls.mass.shape, random)[..., None]
            balls = replace(balls, velocity=balls.velocity + changes * _normal(balls.velocity.shape, random))
        balls = self._resample(balls, self._misfit(balls, observed, FRAMES[-1]), random)
        in_c = replace(balls, position=initial.expand_as(balls.position), presence=present.expand_as(balls.presence))
        return self.arena.roll_out(in_c, len(observed) - 1)

    def weigh_hypotheses(
        self, observed: Float[Tensor, "time ball 2"], random: torch.Generator
    ) -> tuple[Float[Tensor, "hypothesis ball 2"], Float[Tensor, "hypothesis"]]:
        """Return combinations of mass and friction of all balls, and the logarithm of the evidence for each."""
        balls, choices = observed.shape[1], len(self.values)
        if choices**balls <= self.hypotheses:
            values = self.values[torch.cartesian_prod(*[torch.arange(choices)] * balls).view(-1, balls)]
            return values, self._evidence(values.float(), observed.float(), random).double()
        tried = torch.empty(0, balls, dtype=torch.long)
        evidence = torch.empty(0)
        for _ in range(3):  # at random, then around the best
            drawn = torch.randint(choices, (self.hypotheses, balls), generator=random)
            if len(tried):
                parents = tried[
                    evidence.softmax(dim=0).multinomial(self.hypotheses, replacement=True, generator=random)
                ]
                changes = torch.rand(parents.shape, generator=random) < 1.5 / balls
                drawn = torch.where(changes, drawn, parents)
            drawn = torch.unique(drawn, dim=0)
            drawn = drawn[~(drawn[:, None] == tried[None]).all(dim=-1).any(dim=1)]
            if len(drawn):
                tried = torch.cat([tried, drawn])
                evidence = torch.cat([evidence, self._evidence(self.values[drawn].float(), observed.float(), random)])
        return self.values[tried], evidence.double()

    def _evidence(
        self,
        values: Float[Tensor, "hypothesis ball 2"],
        observed: Float[Tensor, "time ball 2"],
        random: torch.Generator,
    ) -> Float[Tensor, "hypothesis"]:
        """Follow AB under each hypothesis: predict a frame, weigh the particles, correct them by what is observed."""
        mass, friction = values.repeat_interleave(self.followers, dim=0).unbind(dim=-1)
        motion = observed[1] - observed[0]
        start = observed[:1].expand(len(mass), -1, -1)
        balls = Spheres(start, SPEED_AFTER_SLIDING * motion.expand_as(start), mass, friction, mass > 0)
        now, evidence = at_start(balls), torch.zeros(len(values), dtype=observed.dtype)
        first = torch.arange(len(values))[:, None] * self.followers
        for time, then in enumerate(observed[1:]):
            width = _choice(JITTERS, SHARES, mass.shape, random)
            if time == 0:
                width = torch.where(torch.rand(mass.shape, generator=random) < START_SHARE, START_JITTER, width)
            jitter = width[..., None].to(mass) * torch.randn(now.velocity.shape, generator=random)
            jitter[first[:, 0]] = 0  # one particle keeps its velocity
            # a ball that already rolls keeps 5/7 of a change of velocity in its rotation
            moved = now._replace(velocity=now.velocity + jitter, rolling=now.rolling + jitter * ROLL / (1 + ROLL))
            after = self.arena.step(moved, balls)
            error = then - after.position
            fit = -DEGREES / 2 * (error.square().sum(-1) / self.error**2).log1p().sum(-1).view(len(values), -1)
            if time > 0:  # the first frame only sets the velocities
                evidence += fit.logsumexp(dim=1)
            weights = fit.softmax(dim=1)
            chosen = (first + weights.multinomial(self.followers, replacement=True, generator=random)).flatten()
            correction = error.clamp(-MAX_CORRECTION, MAX_CORRECTION)
            now = Motion(
                then.expand_as(after.position),
                (after.velocity + correction)[chosen],
                (after.rolling + correction)[chosen],
                after.spin[chosen],
            )
        return evidence

    def _fit_velocities(
        self, balls: Spheres, observed: Float[Tensor, "time ball 2"], random: torch.Generator
    ) -> Spheres:
        """Fit the initial velocities of each draw to the first frames: Levenberg–Marquardt with robust weights."""
        motion = (observed[1] - observed[0]).expand_as(balls.position)
        velocity = motion
        for _ in range(3):  # of balls that touch nothing in the first frame
            reached = self.arena.roll_out(replace(balls, velocity=velocity), 1)[:, 0] - balls.position
            velocity = velocity + (motion - reached).clamp(-MAX_CORRECTION, MAX_CORRECTION)
        touches = torch.rand(balls.mass.shape, generator=random)[..., None] < START_SHARE
        velocity = torch.where(touches, motion + START_JITTER * _normal(motion.shape, random), velocity)
        balls = replace(balls, velocity=velocity)
        draws, unknowns = len(velocity), velocity[0].numel()
        nudges = DIFFERENCE * torch.eye(unknowns, dtype=velocity.dtype).view(unknowns, *velocity.shape[1:])
        repeated = torch.arange(draws).repeat_interleave(unknowns)
        damping = torch.full((draws,), 1e-2, dtype=velocity.dtype)
        error, misfit = self._errors(balls, observed, FIRST_FRAMES), self._misfit(balls, observed, FIRST_FRAMES)
        for _ in range(ITERATIONS):
            nudged = replace(balls[repeated], velocity=(balls.velocity[:, None] + nudges).flatten(0, 1))
            slopes = (
                self._errors(nudged, observed, FIRST_FRAMES).view(draws, unknowns, *error.shape[1:]) - error[:, None]
            )
            weights = 1 / (1 + error.square().sum(-1, keepdim=True) / (2 * self.error) ** 2)
            slope, weighted = (slopes / DIFFERENCE).flatten(2), (weights * error).flatten(1)
            matrix = slope @ (slope * weights.expand_as(error).flatten(1)[:, None]).transpose(1, 2)
            matrix = matrix + damping[:, None, None] * torch.eye(unknowns, dtype=matrix.dtype)
            step = -torch.linalg.solve(matrix, slope @ weighted[..., None])[..., 0]
            step = step * (MAX_CORRECTION / step.abs().amax(dim=1, keepdim=True).clamp(min=TINY)).clamp(max=1)
            moved = replace(balls, velocity=balls.velocity + step.view_as(velocity))
            new_error, new_misfit = (
                self._errors(moved, observed, FIRST_FRAMES),
                self._misfit(moved, observed, FIRST_FRAMES),
            )
            better = new_misfit < misfit
            balls = replace(balls, velocity=torch.where(better[:, None, None], moved.velocity, balls.velocity))
            error = torch.where(better[:, None, None, None], new_error, error)
            misfit = torch.where(better, new_misfit, misfit)
            damping = torch.where(better, 0.3 * damping, 10 * damping)
        return self._resample(balls, misfit, random)

    def _errors(
        self, balls: Spheres, observed: Float[Tensor, "time ball 2"], frames: int
    ) -> Float[Tensor, "draw frame ball 2"]:
        """Return the difference to AB in the first frames, or in all if AB has fewer."""
        target = observed[1 : frames + 1]
        return self.arena.roll_out(balls, len(target)) - target

    def _misfit(self, balls: Spheres, observed: Float[Tensor, "time ball 2"], frames: int) -> Float[Tensor, "draw"]:
        """Return the negative log-likelihood of AB up to a frame."""
        squared = self._errors(balls, observed, frames).square().sum(-1)
        return DEGREES / 2 * (squared / self.error**2).log1p().sum(dim=(1, 2))

    @staticmethod
    def _resample(balls: Spheres, misfit: Float[Tensor, "draw"], random: torch.Generator) -> Spheres:
        weights = (-TEMPERATURE * misfit).softmax(dim=0)
        return balls[weights.multinomial(len(misfit), replacement=True, generator=random)]


def _normal(shape: torch.Size, random: torch.Generator) -> Float[Tensor, "..."]:
    return torch.randn(shape, generator=random, dtype=torch.float64)


def _choice(
    values: tuple[float, ...], shares: tuple[float, ...], shape: torch.Size, random: torch.Generator
) -> Float[Tensor, "..."]:
    """Draw from values with probabilities."""
    rows = torch.tensor(shares).multinomial(shape.numel(), replacement=True, generator=random)
    return torch.tensor(values, dtype=torch.float64)[rows].view(shape)
