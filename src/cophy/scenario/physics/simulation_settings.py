"""How a scene is simulated: the solver's settings, how long a sequence is and how often it is sampled."""

from dataclasses import dataclass

MOST = 10_000  # steps per second, and iterations per step: far more than helps


@dataclass
class Solver:
    """Settings of Bullet's constraint solver; docs/benchmark/physics.md shows how they were chosen.

    elastic_impacts: resolve penetration apart from velocity and let contacts act only once bodies touch. Otherwise
        impacts gain speed from the push out of penetration, and lose it to a brake within 2 cm before the touch:
        harmless to blocks that come to rest, but elastic balls gain up to 4 % or lose most of their speed.
    """

    step_rate_hz: int
    iterations: int
    elastic_impacts: bool

    def __post_init__(self) -> None:
        for key in ("step_rate_hz", "iterations"):
            if not 0 < getattr(self, key) <= MOST:
                raise ValueError(f"scenario.solver.{key}={getattr(self, key)} must be from 1 to {MOST}")


@dataclass
class Clock:
    """How long a sequence is and how often it is sampled (paper Sec. 3: 6 s, states at 20 fps, video at 5 fps)."""

    num_frames: int
    frame_rate_hz: int
    state_rate_hz: int

    def __post_init__(self) -> None:
        if self.num_frames < 2 or self.frame_rate_hz <= 0 or self.state_rate_hz % self.frame_rate_hz:
            raise ValueError(f"clock: state_rate_hz must be a multiple of frame_rate_hz, num_frames at least 2: {self}")

    @property
    def states_per_frame(self) -> int:
        """Stored states per video frame."""
        return self.state_rate_hz // self.frame_rate_hz

    @property
    def num_states(self) -> int:
        """Stored states per sequence; frame t is state t · states_per_frame."""
        return self.num_frames * self.states_per_frame
