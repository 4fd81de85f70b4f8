"""Speed as ratios within one run: `just bench`. Prints a table and writes outputs/bench.json."""

import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from rich.console import Console
from rich.table import Table

from cophy import config
from cophy.scenario import Scenario, Simulator
from cophy.training.losses import position_loss, stability_loss
from cophy.training.run import build_network
from cophy.types import CONFOUNDERS, Batch

ROOT = Path(__file__).parents[1]
REPEATS = 5
NUM_OBJECTS = {"blocktower": 3, "balls": 4, "collision": 2}


def main() -> None:
    """Measure everything, print it, keep it."""
    config.register()
    torch.set_num_threads(1)
    rows: list[tuple[str, str, float]] = []
    with Simulator() as simulator:
        for name, count in NUM_OBJECTS.items():
            scenario = composed("generate", f"scenario={name}").scenario
            rows.append(
                (
                    f"simulation, {name}",
                    "CPU per simulation ÷ its bare stepSimulation calls",
                    simulation(scenario, count, simulator),
                )
            )
            rows.append(
                (f"search, {name}", "CPU per twin pair ÷ its four simulations", search(scenario, count, simulator))
            )
    for batch_size in (64, 128, 512):
        rows.append(
            (
                f"CoPhyNet, batch {batch_size}",
                "experiments/s ÷ those at batch 32, 3 objects in 4 slots",
                training(batch_size),
            )
        )
    table = Table("what", "unit", "median")
    for what, unit, value in rows:
        table.add_row(what, unit, f"{value:.2f}")
    Console().print(table)
    path = ROOT / "outputs" / "bench.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps([{"what": what, "unit": unit, "median": value} for what, unit, value in rows], indent=2))


def composed(name: str, *overrides: str):
    """A typed configuration."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return OmegaConf.to_object(compose(name, list(overrides)))


def cpu_seconds(run: Callable[[], object]) -> float:
    """CPU time of one call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def simulation(scenario: Scenario, num_objects: int, simulator: Simulator) -> float:
    """Overhead of scene set-up and reading states."""
    experiment, _ = scenario.twin_pair(num_objects, seed=0, pair=0, simulator=simulator)
    solver, clock = scenario.solver, scenario.clock
    steps = (clock.num_states - 1) * solver.step_rate_hz // clock.state_rate_hz

    def bare() -> None:
        simulator._reset(experiment.scene, solver)
        for body in experiment.scene.bodies:
            simulator._add(body, solver)

    def bare_steps() -> None:
        for _ in range(steps):
            simulator._bullet.stepSimulation(simulator._client)

    ratios = []
    for _ in range(REPEATS):
        whole = cpu_seconds(lambda: [scenario.simulate(simulator, experiment.scene) for _ in range(5)]) / 5
        alone = 0.0
        for _ in range(5):
            bare()
            alone += cpu_seconds(bare_steps) / 5
        ratios.append(whole / alone)
    return statistics.median(ratios)


def search(scenario: Scenario, num_objects: int, simulator: Simulator) -> float:
    """Overhead of looking for experiments."""
    ratios = []
    for repeat in range(REPEATS):
        pairs = range(12 * repeat, 12 * repeat + 12)
        found: list = []
        whole = cpu_seconds(
            lambda pairs=pairs, found=found: found.extend(
                experiment
                for pair in pairs
                for experiment in scenario.twin_pair(num_objects, seed=0, pair=pair, simulator=simulator)
            )
        )
        scenes = [scene for e in found for scene in (e.scene, e.do_operation.apply(e.scene))]
        ratios.append(
            whole / cpu_seconds(lambda scenes=scenes: [scenario.simulate(simulator, scene) for scene in scenes])
        )
    return statistics.median(ratios)


def training(batch_size: int) -> float:
    """Throughput of forward, backward and Adam."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        model = OmegaConf.to_container(compose("train").model, enum_to_str=True)
    network = build_network(model)
    optimizer = torch.optim.Adam(network.parameters())

    def step(batch: Batch) -> None:
        prediction = network(batch)
        loss = position_loss(prediction, batch) + stability_loss(prediction.stable_logit, batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    small, large = random_batch(32), random_batch(batch_size)
    step(small)
    ratios = []
    for _ in range(REPEATS):
        ratios.append(batch_size / cpu_seconds(lambda: step(large)) * cpu_seconds(lambda: step(small)) / 32)
    return statistics.median(ratios)


def random_batch(size: int) -> Batch:
    """Three objects in four slots, thirty frames."""
    presence = torch.ones(size, 4, dtype=torch.bool)
    presence[torch.arange(size), torch.randint(4, (size,))] = False
    return Batch(
        observed=torch.randn(size, 30, 4, 3),
        observed_presence=presence,
        observed_stable=torch.rand(size, 29, 4) > 0.5,
        initial=torch.randn(size, 4, 3),
        presence=presence,
        confounders=torch.randn(size, 4, len(CONFOUNDERS)),
        confounder_class=torch.randint(0, 2, (size, 4, 2)),
        target=torch.randn(size, 29, 4, 3),
        stable=torch.rand(size, 29, 4) > 0.5,
    )


if __name__ == "__main__":
    main()
