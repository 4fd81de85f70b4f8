"""Simulation, search, rendering, and what a second worker brings."""

import tempfile
import time
from pathlib import Path

from measure import NUM_OBJECTS, REPEATS, Measured, cpu_seconds
from speed_startup import cpu_seconds_of

from cophy.config import settings
from cophy.dataset.images import Images
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.states import States
from cophy.scenario import Experiment, Scenario, Simulator
from cophy.scenario.rendering import MODALITIES, Backend, RenderSettings

SIMULATIONS_AT_ONCE = 20
PAIRS_AT_ONCE = 24
RESOLUTION = 224


def measure() -> list[Measured]:
    """Measure all ratios of generation."""
    rows = []
    with Simulator() as simulator:
        for name, count in NUM_OBJECTS.items():
            scenario = settings("generate", f"scenario={name}").scenario
            simulated, searched = simulation(scenario, count, simulator), search(scenario, count, simulator)
            reach = "≤ 1.15" if name == "blocktower" else "≤ 2.0"
            rows.append(Measured(f"simulation, {name}", "÷ its bare stepSimulation calls", simulated, "≤ 1.15"))
            rows.append(Measured(f"search, {name}", "÷ simulating what was accepted", searched, reach))
    rows += [
        Measured(f"rendering, {name}", "÷ its bare getCameraImage calls", rendering(name), "≤ 1.2")
        for name in NUM_OBJECTS
    ]
    rows.append(Measured("2 workers, towers", "throughput ÷ that of 1, from CPU times", second_worker(), "≥ 1.9"))
    return rows


def simulation(scenario: Scenario, num_objects: int, simulator: Simulator) -> list[float]:
    """Measure the CPU time of simulating A ÷ that of its bare calls of stepSimulation (bodies, reading of states)."""
    experiment, _ = scenario.twin_pair(num_objects, data_seed=0, pair=0, simulator=simulator)
    clock = scenario.clock

    def bare() -> float:
        calls = simulator._reset(experiment.scene, scenario.solver, clock.state_rate_hz)  # per state
        simulator._add_all(experiment.scene, scenario.solver)
        step, client = simulator._bullet.stepSimulation, simulator._client
        return cpu_seconds(lambda: [step(client) for _ in range((clock.num_states - 1) * calls)])

    def whole() -> float:
        return cpu_seconds(lambda: scenario.simulate(simulator, experiment.scene))

    ratios = []
    for _ in range(REPEATS):
        pairs = [(whole(), bare()) for _ in range(SIMULATIONS_AT_ONCE)]
        ratios.append(sum(w for w, _ in pairs) / sum(b for _, b in pairs))
    return ratios


def search(scenario: Scenario, num_objects: int, simulator: Simulator) -> list[float]:
    """Measure the CPU time of searching twin pairs ÷ that of simulating those it accepted; new pairs in every repeat."""
    ratios = []
    for repeat in range(REPEATS):
        experiments: list[Experiment] = []
        start = time.process_time()
        for pair in range(PAIRS_AT_ONCE * repeat, PAIRS_AT_ONCE * (repeat + 1)):
            experiments += scenario.twin_pair(num_objects, data_seed=0, pair=pair, simulator=simulator)
        searched = time.process_time()
        for experiment in experiments:
            scenario.simulate(simulator, experiment.scene)
            scenario.simulate(simulator, experiment.do_operation.apply(experiment.scene))
        ratios.append((searched - start) / (time.process_time() - searched))
    return ratios


def rendering(name: str) -> list[float]:
    """Measure the overhead of stages, bodies, conversion, compression and boxes, at 224 × 224 with all three modalities."""
    with tempfile.TemporaryDirectory() as data_dir:
        states = generate_states(name, NUM_OBJECTS[name], 2 * REPEATS, Path(data_dir))
        images = Images(states, RenderSettings(list(MODALITIES), RESOLUTION, Backend.tiny))
        return [seconds / camera for seconds, camera in (draw(images, shard) for shard in range(REPEATS))]


def second_worker() -> list[float]:
    """Measure twice the CPU time of generation with one worker ÷ that with two: their throughputs, had each worker a core."""
    return [2 * _generating(1) / _generating(2) for _ in range(REPEATS)]


def _generating(workers: int) -> float:
    """Measure the CPU-s of generate.py and its workers for 480 towers in four shards."""
    size = ["size=tiny", "size.experiments_per_shard=120", "size.num_experiments.blocktower.3=480"]
    with tempfile.TemporaryDirectory() as data_dir:
        return cpu_seconds_of("generate.py", "num_objects=[3]", f"workers={workers}", f"data_dir={data_dir}", *size)


def generate_states(name: str, num_objects: int, num_experiments: int, data_dir: Path) -> States:
    """Generate a dataset of `num_experiments` experiments in `data_dir`, two in each shard."""
    scenario = settings("generate", f"scenario={name}").scenario
    size = Size("bench", 2, {name: {str(num_objects): num_experiments}})
    states = States(DatasetSpec(scenario, num_objects, size, 0), data_dir)
    states.directory.mkdir(parents=True)
    for shard in range(states.spec.num_shards):
        states.write(states.path(shard), shard, lambda done: None)
    states.write_manifest()
    return states


def draw(images: Images, shard: int) -> tuple[float, float]:
    """Measure the CPU-s of drawing and storing a shard, and of these inside PyBullet's camera."""
    images.directory.mkdir(exist_ok=True)
    start = time.process_time()
    cost = images.write(images.path(shard), shard, lambda done: None)
    return time.process_time() - start, cost["CPU-s inside PyBullet's camera"]
