"""Write docs/benchmark/physics.md: closed forms, convergence and cost of the solver settings. python benchmarks/dataset/physics.py

Takes about ten minutes on one core. Every number in the document comes from the run that wrote it.
"""

import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cophy.app.composition import settings
from cophy.app.schemas.registration import register
from cophy.scenario import Blocktower, Body, Clock, Scene, Shape, Simulator, Solver, Trajectory
from cophy.scenario.confounders import Confounders
from cophy.scenario.experiment import with_confounders
from cophy.scenario.physics.energy import largest_gain
from cophy.scenario.physics.scene import Vector, trajectory_distance
from cophy.scenario.physics.statics import Combinations
from cophy.scenario.physics.surroundings import floor

ROOT = Path(__file__).parents[2]
CLOCK = Clock(num_frames=30, frame_rate_hz=5, state_rate_hz=20)
SECONDS = (CLOCK.num_states - 1) / CLOCK.state_rate_hz
NUM_TOWERS = 100
NUM_PAIRS = 20
NUM_SEQUENCES = 400
G = 10.0
CUBE = (1.0, 1.0, 1.0)
TOWER_SOLVERS = [
    Solver(rate, n, False) for rate, n in ((240, 50), (240, 100), (240, 200), (240, 400), (480, 100), (960, 50))
]
IMPACT_SOLVERS = [
    Solver(rate, n, True) for rate, n in ((120, 50), (240, 20), (240, 50), (240, 100), (480, 50), (960, 50))
]


def main() -> None:
    """Measure, then write."""
    register()
    with Simulator() as simulator:
        sections = [closed_forms(simulator), towers(simulator)]
        sections += [convergence(name, count, simulator) for name, count in (("balls", 4), ("collision", 2))]
        sections.append(energies(simulator))
    head = (
        "# Physics\n\nDoes the simulation agree with closed forms, and what do more solver steps change?\n"
        "This page is written by `python benchmarks/dataset/physics.py`. CPU times are of one core of the machine it ran on.\n"
        "Compare them with each other.\n"
    )
    (ROOT / "docs" / "benchmark" / "physics.md").write_text("\n".join([head, *sections]))


def scenario(name: str) -> Any:
    """A scenario as conf/ has it."""
    return settings("generate", f"scenario={name}").scenario


def closed_forms(simulator: Simulator) -> str:
    """What simulation gives where theory knows the answer, under the solver of each scenario."""
    impacts, blocks = scenario("balls").solver, scenario("blocktower").solver

    def last(*bodies: Body, solver: Solver, gravity: float = -G) -> np.ndarray:
        scene = Scene(bodies, (0.0, 0.0, gravity))
        return np.asarray(simulator.simulate(scene, solver=solver, clock=CLOCK, num_slots=2).states[-1])

    falling = Body(Shape.SPHERE, CUBE, (0, 0, 1000.0), 0, 1.0)
    rows = [("free fall for 5.95 s, m", G * SECONDS**2 / 2, 1000.0 - last(falling, solver=blocks)[0, 2])]
    for first, second in ((1.0, 1.0), (1.0, 10.0), (10.0, 1.0)):
        hitting = Body(Shape.SPHERE, CUBE, (-2, 0, 9), 0, first, 0.0, 1.0, linear_velocity=(3.0, 0, 0))
        resting = Body(Shape.SPHERE, CUBE, (0, 0, 9), 1, second, 0.0, 1.0)
        speed = last(hitting, resting, solver=impacts, gravity=0.0)[:, 7]
        what = f"elastic impact {first:g} kg on {second:g} kg: speed of the"
        rows.append((f"{what} first, m/s", (first - second) / (first + second) * 3, speed[0]))
        rows.append((f"{what} second, m/s", 2 * first / (first + second) * 3, speed[1]))
    for friction in (0.5, 1.0):
        slab = last(floor(), sliding(Shape.BOX, (1, 1, 0.2), friction=friction), solver=blocks)[0]
        rows.append((f"slab sliding at 4 m/s, friction {friction}: distance, m", 16 / (2 * friction * G), slab[0]))
        ball = last(floor(), sliding(Shape.SPHERE, CUBE, friction=friction), solver=impacts)[0]
        rows.append((f"sphere launched at 4 m/s, friction {friction}: rolling speed, m/s", 4 * 5 / 7, ball[7]))
    standing = last(floor(), sliding(Shape.CYLINDER, CUBE), solver=impacts)[0]
    rows.append(("standing cylinder sliding at 4 m/s, friction 0.5: distance, m", 1.6, standing[0]))
    half = float(np.sqrt(0.5))
    lying = last(floor(), replace(sliding(Shape.CYLINDER, CUBE), quaternion_xyzw=(half, 0, 0, half)), solver=impacts)[0]
    rows.append(("lying cylinder launched at 4 m/s: rolling speed, m/s", 4 * 2 / 3, lying[7]))
    lines = [f"| {what} | {expected:.4f} | {found:.4f} | {found - expected:+.4f} |" for what, expected, found in rows]
    head = ["## Closed forms", "", "| | theory | simulated | difference |", "|---|---|---|---|"]
    return "\n".join(
        [*head, *lines, "", "A standing cylinder slides several per cent short. Why was not looked into.", ""]
    )


def sliding(shape: Shape, size_m: Vector, *, friction: float = 0.5) -> Body:
    """A body on the floor, at 4 m/s along x."""
    return Body(shape, size_m, (0, 0, size_m[2] / 2), 0, 1.0, friction, linear_velocity=(4.0, 0, 0))


def random_towers(blocktower: Blocktower) -> tuple[list[Scene], np.ndarray]:
    """Scenes, half of which stand on paper, and their margins, metres."""
    rng, scenes, margins = np.random.default_rng(0), list[Scene](), list[float]()
    while len(scenes) < NUM_TOWERS:
        tower = blocktower.tower_search.random_towers(3, rng).take(np.array([0]))
        mass, friction, gravity = rng.choice([1.0, 10.0], 3), rng.choice([0.5, 1.0], 3), rng.choice([-1.0, 0.0, 1.0], 2)
        margin = float(blocktower.statics.margins(*tower, Combinations(mass[None], gravity[None] / G))[0, 0])
        if (margin > 0) == len(scenes) % 2:
            continue
        confounders = Confounders(tuple(mass), tuple(friction), (0.0,) * 3, tuple(gravity))
        scenes.append(with_confounders(blocktower.tower_search.scene(tower, 0, (0, 1, 2)), confounders))
        margins.append(margin)
    return scenes, np.array(margins)


def towers(simulator: Simulator) -> str:
    """Agreement of simulation and statics, and what it costs."""
    blocktower: Blocktower = scenario("blocktower")
    scenes, margin = random_towers(blocktower)
    lines, labels = [], {}
    for solver in tqdm(TOWER_SOLVERS, desc="towers"):
        trajectories, cost = simulated(scenes, solver, simulator, num_slots=4)
        moved = np.array([np.linalg.norm(t.positions - t.positions[0], axis=-1).max() for t in trajectories])
        stands = np.array([blocktower.statics.stands(trajectory) for trajectory in trajectories])
        labels[(solver.step_rate_hz, solver.iterations)] = stands
        agrees = stands == (margin > 0)
        clear = np.abs(margin) >= blocktower.min_margin
        chosen = " **(chosen)**" if solver == blocktower.solver else ""
        lines.append(
            f"| {solver.step_rate_hz} Hz, {solver.iterations} iterations{chosen} | {agrees.mean():.0%} | {agrees[clear].mean():.0%} | "
            f"{(~stands[margin > 0]).mean():.0%} | {moved[stands].max(initial=0) * 1000:.1f} | {cost:.1f} |"
        )
    halved = (labels[(240, 100)] != labels[(480, 100)]).mean()
    columns = (
        "solver",
        "agrees with statics",
        f"beyond a margin of {blocktower.min_margin} m",
        "standing on paper, falls",
        "largest creep of what stands, mm",
        "CPU-ms per simulated second",
    )
    text = f"{NUM_TOWERS} random towers of three, half of which stand on paper; 5.95 s of simulation."
    after = f"Halving the step of the chosen setting changes {halved:.0%} of the labels."
    return "\n".join(["## Towers", "", text, "", *head_of(columns), *lines, "", after, ""])


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


def convergence(name: str, num_objects: int, simulator: Simulator) -> str:
    """How far trajectories are from those at a four times finer step, against how far twins are apart."""
    chosen = scenario(name)
    experiments = [
        experiment
        for pair in range(NUM_PAIRS)
        for experiment in chosen.twin_pair(num_objects, data_seed=0, pair=pair, simulator=simulator)
    ]
    scenes = [experiment.scene for experiment in experiments]
    twins = [
        trajectory_distance(a.observed, b.observed) for a, b in zip(experiments[::2], experiments[1::2], strict=True)
    ]
    results = {}
    for solver in tqdm(IMPACT_SOLVERS, desc=name):
        rates = (solver.step_rate_hz, solver.iterations)
        results[rates] = simulated(scenes, solver, simulator, num_slots=chosen.num_slots)
    finest = results[(960, 50)][0]
    lines = []
    for (rate, iterations), (trajectories, cost) in results.items():
        distance = [trajectory_distance(a, b) for a, b in zip(trajectories, finest, strict=True)]
        mark = " **(chosen)**" if (rate, iterations) == (chosen.solver.step_rate_hz, chosen.solver.iterations) else ""
        lines.append(
            f"| {rate} Hz, {iterations} iterations{mark} | {np.median(distance):.3f} | {np.quantile(distance, 0.9):.3f} | {cost:.1f} |"
        )
    return "\n".join(
        [
            f"## {name.capitalize()}",
            "",
            f"Observed sequences of {len(scenes)} experiments with {num_objects} objects, compared with the same scenes at 960 Hz.",
            "Distances are averaged over time, of the object that differs most.",
            f"For comparison, twins are {np.median(twins):.2f} m apart in the median.",
            "",
            *head_of(("solver", "median, m", "90 % quantile, m", "CPU-ms per simulated second")),
            *lines,
            "",
        ]
    )


def energies(simulator: Simulator) -> str:
    """How often an impact of balls makes energy, and what it takes."""
    balls, rng, scenes = scenario("balls"), np.random.default_rng(0), []
    for _ in range(NUM_SEQUENCES):
        scene = balls.sample_scene(0, (0, 1, 2, 3), rng)
        scenes.append(balls.under(int(rng.integers(balls.confounders.num_configurations(4))), scene))

    def alike(**values: float) -> list[Scene]:
        return [
            replace(s, bodies=tuple(replace(b, **values) if b.slot is not None else b for b in s.bodies))
            for s in scenes
        ]

    chosen, fine = balls.solver, replace(balls.solver, step_rate_hz=960)
    lines = []
    for what, solver, varied in tqdm(
        [
            ("as configured", chosen, scenes),
            ("at 960 Hz", fine, scenes),
            ("all of 1 kg", chosen, alike(mass=1.0)),
            ("all without friction", chosen, alike(friction=0.0)),
            ("restitution 0.9", chosen, alike(restitution=0.9)),
        ],
        desc="energy",
    ):
        gains = np.array(
            [largest_gain(s, simulator.simulate(s, solver=solver, clock=CLOCK, num_slots=9)) for s in varied]
        )
        lines.append(
            f"| {what} | {(gains > balls.max_energy_gain).mean():.1%} | {(gains > 0.05).mean():.1%} | {gains.max():.1%} |"
        )
    return "\n".join(
        [
            "## Energy",
            "",
            f"{NUM_SEQUENCES} random sequences of four balls, not searched. From one state to the next, 50 ms later, how many gain",
            "more than a share of their initial energy? And how much is the largest gain?",
            "",
            *head_of(("balls", f"more than {balls.max_energy_gain:.0%}", "more than 5 %", "largest")),
            *lines,
            "",
            "The impacts that gain are of a heavy ball, itself off the floor, on a light one that lies on it.",
            "Friction between the two presses the light ball down, so the floor can stop its sliding at once.",
            "Meanwhile restitution is promised along the line of centres.",
            "Newton's law of restitution with friction at two contacts does not conserve energy (Kane's paradox).",
            f"Such sequences are not kept: `max_energy_gain: {balls.max_energy_gain}`.",
            "",
        ]
    )


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
