"""Do impacts of balls make energy?"""

from dataclasses import replace

import numpy as np
from sections import CLOCK, head_of, scenario
from tqdm import tqdm

from cophy.scenario import Scene, Simulator
from cophy.scenario.physics import largest_gain

NUM_SEQUENCES = 400


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
