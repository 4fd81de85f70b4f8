"""What the sections of docs/benchmark/physics.md share."""

import time
from collections.abc import Sequence
from typing import Any

from cophy.config import settings
from cophy.scenario import Clock, Scene, Simulator, Solver, Trajectory

CLOCK = Clock(num_frames=30, frame_rate_hz=5, state_rate_hz=20)
SECONDS = (CLOCK.num_states - 1) / CLOCK.state_rate_hz


def scenario(name: str) -> Any:
    """A scenario as conf/ has it."""
    return settings("generate", f"scenario={name}").scenario


def head_of(columns: Sequence[str]) -> list[str]:
    """The head of a table."""
    return [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]


def simulated(
    scenes: list[Scene], solver: Solver, simulator: Simulator, *, num_slots: int
) -> tuple[list[Trajectory], float]:
    """Trajectories, and CPU-ms per simulated second."""
    start = time.process_time()
    trajectories = [simulator.simulate(scene, solver=solver, clock=CLOCK, num_slots=num_slots) for scene in scenes]
    return trajectories, (time.process_time() - start) / len(scenes) / SECONDS * 1000
