"""Write docs/physics.md: closed forms, convergence and cost of the solver settings. python benchmarks/physics.py

Takes about ten minutes on one core. Every number in the document comes from the run that wrote it.
"""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from tqdm import tqdm

from cophy import config
from cophy.scenario import Blocktower, Body, Clock, Scene, Shape, Simulator, Solver
from cophy.scenario.confounders import Confounders
from cophy.scenario.energy import largest_gain
from cophy.scenario.experiment import with_confounders
from cophy.scenario.scene import trajectory_distance
from cophy.scenario.stability import tower_margins
from cophy.scenario.surroundings import floor

ROOT = Path(__file__).parents[1]
CLOCK = Clock(num_frames=30, frame_rate_hz=5, state_rate_hz=20)
SECONDS = (CLOCK.num_states - 1) / CLOCK.state_rate_hz
NUM_TOWERS = 100
NUM_PAIRS = 20
NUM_SEQUENCES = 400
G = 10.0
TOWER_SOLVERS = [
    Solver(rate, n, False) for rate, n in ((240, 50), (240, 100), (240, 200), (240, 400), (480, 100), (960, 50))
]
IMPACT_SOLVERS = [
    Solver(rate, n, True) for rate, n in ((120, 50), (240, 20), (240, 50), (240, 100), (480, 50), (960, 50))
]


def main() -> None:
    """Measure, then write."""
    config.register()
    with Simulator() as simulator:
        sections = [closed_forms(simulator), towers(simulator)]
        sections += [convergence(name, count, simulator) for name, count in (("balls", 4), ("collision", 2))]
        sections.append(energies(simulator))
    head = (
        "# Physics: closed forms, convergence, cost\n\nWritten by `python benchmarks/physics.py`. CPU times are of one "
        "core of the machine it ran on; compare them with each other.\n"
    )
    (ROOT / "docs" / "physics.md").write_text("\n".join([head, *sections]))


def scenario(name: str):
    """A scenario as conf/ has it."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return OmegaConf.to_object(compose("generate", [f"scenario={name}"])).scenario


def closed_forms(simulator: Simulator) -> str:
    """What simulation gives where theory knows the answer, under the solver of each scenario."""
    rows = []

    def run(*bodies: Body, solver: Solver, gravity: float = -G) -> np.ndarray:
        return simulator.simulate(Scene(bodies, (0.0, 0.0, gravity)), solver=solver, clock=CLOCK, num_slots=2).states

    impacts, blocks = scenario("balls").solver, scenario("blocktower").solver
    falling = run(Body(Shape.SPHERE, (1, 1, 1), (0, 0, 1000.0), 0, 1.0), solver=blocks)[-1, 0, 2]
    rows.append(("free fall for 5.95 s, m", G * SECONDS**2 / 2, 1000.0 - falling))
    for first, second in ((1.0, 1.0), (1.0, 10.0), (10.0, 1.0)):
        hitting = Body(Shape.SPHERE, (1, 1, 1), (-2, 0, 9), 0, first, 0.0, 1.0, linear_velocity=(3.0, 0, 0))
        resting = Body(Shape.SPHERE, (1, 1, 1), (0, 0, 9), 1, second, 0.0, 1.0)
        after = run(hitting, resting, solver=impacts, gravity=0.0)[-1, :, 7]
        rows.append(
            (
                f"elastic impact {first:g} kg on {second:g} kg: speed of the first, m/s",
                (first - second) / (first + second) * 3,
                after[0],
            )
        )
        rows.append(
            (
                f"elastic impact {first:g} kg on {second:g} kg: speed of the second, m/s",
                2 * first / (first + second) * 3,
                after[1],
            )
        )
    for friction in (0.5, 1.0):
        slab = Body(Shape.BOX, (1, 1, 0.2), (0, 0, 0.1), 0, 1.0, friction, linear_velocity=(4.0, 0, 0))
        rows.append(
            (
                f"slab sliding at 4 m/s, friction {friction}: distance, m",
                16 / (2 * friction * G),
                run(floor(), slab, solver=blocks)[-1, 0, 0],
            )
        )
        ball = Body(Shape.SPHERE, (1, 1, 1), (0, 0, 0.5), 0, 1.0, friction, linear_velocity=(4.0, 0, 0))
        rows.append(
            (
                f"sphere launched at 4 m/s, friction {friction}: rolling speed, m/s",
                4 * 5 / 7,
                run(floor(), ball, solver=impacts)[-1, 0, 7],
            )
        )
    standing = Body(Shape.CYLINDER, (1, 1, 1), (0, 0, 0.5), 0, 1.0, 0.5, linear_velocity=(4.0, 0, 0))
    rows.append(
        (
            "standing cylinder sliding at 4 m/s, friction 0.5: distance, m",
            1.6,
            run(floor(), standing, solver=impacts)[-1, 0, 0],
        )
    )
    half = float(np.sqrt(0.5))
    lying = Body(
        Shape.CYLINDER,
        (1, 1, 1),
        (0, 0, 0.5),
        0,
        1.0,
        0.5,
        quaternion_xyzw=(half, 0, 0, half),
        linear_velocity=(4.0, 0, 0),
    )
    rows.append(
        (
            "lying cylinder launched at 4 m/s: rolling speed, m/s",
            4 * 2 / 3,
            run(floor(), lying, solver=impacts)[-1, 0, 7],
        )
    )
    lines = [f"| {what} | {expected:.4f} | {found:.4f} | {found - expected:+.4f} |" for what, expected, found in rows]
    return "\n".join(
        ["## Closed forms", "", "| | theory | simulated | difference |", "|---|---|---|---|", *lines, ""]
    ) + ("\nA standing cylinder slides several per cent short; why was not looked into.\n")


def towers(simulator: Simulator) -> str:
    """Agreement of simulation and statics, and what it costs."""
    blocktower: Blocktower = scenario("blocktower")
    rng, scenes, margins = np.random.default_rng(0), [], []
    while len(scenes) < NUM_TOWERS:
        xy, yaw = (values[:1] for values in blocktower._towers(3, rng))
        mass, friction, gravity = rng.choice([1.0, 10.0], 3), rng.choice([0.5, 1.0], 3), rng.choice([-1.0, 0.0, 1.0], 2)
        margin = float(tower_margins(xy, yaw, mass[None], gravity[None] / G)[0, 0])
        if (margin > 0) == len(scenes) % 2:
            continue
        confounders = Confounders(tuple(mass), tuple(friction), (0.0,) * 3, tuple(gravity))
        scenes.append(with_confounders(blocktower._scene(xy[0], yaw[0], (0, 1, 2)), confounders))
        margins.append(margin)
    margin = np.array(margins)
    lines, labels = [], {}
    for solver in tqdm(TOWER_SOLVERS, desc="towers"):
        start = time.process_time()
        trajectories = [simulator.simulate(scene, solver=solver, clock=CLOCK, num_slots=4) for scene in scenes]
        cost = (time.process_time() - start) / NUM_TOWERS / SECONDS * 1000
        stands = np.array([blocktower.stands(trajectory) for trajectory in trajectories])
        labels[(solver.step_rate_hz, solver.iterations)] = stands
        agrees = stands == (margin > 0)
        clear = np.abs(margin) >= blocktower.min_margin
        creeping = max(
            (
                np.linalg.norm(t.positions - t.positions[0], axis=-1).max()
                for t, s in zip(trajectories, stands, strict=True)
                if s
            ),
            default=0.0,
        )
        chosen = " **(chosen)**" if solver == blocktower.solver else ""
        lines.append(
            f"| {solver.step_rate_hz} Hz, {solver.iterations} iterations{chosen} | {agrees.mean():.0%} | {agrees[clear].mean():.0%} | "
            f"{(~stands[margin > 0]).mean():.0%} | {creeping * 1000:.1f} | {cost:.1f} |"
        )
    halved = (labels[(240, 100)] != labels[(480, 100)]).mean()
    return "\n".join(
        [
            "## Towers",
            "",
            f"{NUM_TOWERS} random towers of three, half of which stand on paper; 5.95 s of simulation.",
            "",
            f"| solver | agrees with statics | beyond a margin of {blocktower.min_margin} m | standing on paper, falls | largest creep of what stands, mm | CPU-ms per simulated second |",
            "|---|---|---|---|---|---|",
            *lines,
            "",
            f"Halving the step of the chosen setting changes {halved:.0%} of the labels.",
            "",
        ]
    )


def convergence(name: str, num_objects: int, simulator: Simulator) -> str:
    """How far trajectories are from those at a four times finer step, against how far twins are apart."""
    chosen = scenario(name)
    experiments = [
        experiment
        for pair in range(NUM_PAIRS)
        for experiment in chosen.twin_pair(num_objects, seed=0, pair=pair, simulator=simulator)
    ]
    scenes = [experiment.scene for experiment in experiments]
    twins = [
        trajectory_distance(a.observed, b.observed) for a, b in zip(experiments[::2], experiments[1::2], strict=True)
    ]
    results = {}
    for solver in tqdm(IMPACT_SOLVERS, desc=name):
        start = time.process_time()
        trajectories = [
            simulator.simulate(scene, solver=solver, clock=CLOCK, num_slots=chosen.num_slots) for scene in scenes
        ]
        results[(solver.step_rate_hz, solver.iterations)] = (
            trajectories,
            (time.process_time() - start) / len(scenes) / SECONDS * 1000,
        )
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
            f"Observed sequences of {len(scenes)} experiments with {num_objects} objects: distance to the same scene at 960 Hz "
            f"(time-averaged, of the object that differs most). Their twins are {np.median(twins):.2f} m apart in the median.",
            "",
            "| solver | median, m | 90 % quantile, m | CPU-ms per simulated second |",
            "|---|---|---|---|",
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
            f"{NUM_SEQUENCES} random sequences of four balls, not searched: how many gain more than a share of their initial energy "
            "from one state to the next, 50 ms later, and the largest gain.",
            "",
            f"| balls | more than {balls.max_energy_gain:.0%} | more than 5 % | largest |",
            "|---|---|---|---|",
            *lines,
            "",
            "The impacts that gain are of a heavy ball, itself off the floor, on a light one that lies on it. Friction between the "
            "two presses the light ball down, so that the floor can stop its sliding at once, while restitution is promised along "
            "the line of centres: Newton's law of restitution with friction at two contacts does not conserve energy "
            f"(Kane's paradox). Such sequences are not kept: `max_energy_gain: {balls.max_energy_gain}`.",
            "",
        ]
    )


if __name__ == "__main__":
    main()
