"""Baselines, balance and cost of a generated dataset, without a trained model: python benchmarks/dataset/data_report.py scenario=balls size=small

Takes what generate.py takes, and prints a Markdown table with a column per dataset. Copy baselines are evaluated on all experiments.
"""

import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from cophy.audit.checks import share_with_effect
from cophy.audit.resimulation import scenes_of
from cophy.bootstrap import interval, mean
from cophy.config import generated_by, settings
from cophy.dataset.difficulty import stands, twin_differences
from cophy.dataset.features import to_batch
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import clusters_of, slots_in_order, sort_by_twins
from cophy.models.baselines import CopyB, CopyC
from cophy.scenario import Scenario, Simulator
from cophy.scenario.physics import Trajectory
from cophy.schemas import register
from cophy.scoring import Predictions, Truth, score
from cophy.training.predictor import prediction_arrays

Arrays = dict[str, np.ndarray]
Lines = Iterator[tuple[str, str]]  # name of a number, and the number

SAMPLE = 40  # experiments that are generated again
NUM_CONVERGENCE = 100  # experiments that are simulated at three rates


def main(*overrides: str) -> None:
    """Print the table; the datasets must be there."""
    register()
    columns = {}
    for states in generated_by(settings("generate", *overrides)):
        columns[f"{states.spec.scenario.name}, {states.spec.num_objects}"] = dict(
            lines(sort_by_twins(states.load(), states.spec), states.spec)
        )
    print(pd.DataFrame(columns).fillna("—").to_markdown())


def lines(arrays: Arrays, spec: DatasetSpec) -> Lines:
    """Yield all numbers of a dataset."""
    yield "experiments", str(spec.num_experiments)
    yield from copy_baselines(arrays, spec)
    observed, counterfactual = np.median(twin_differences(arrays), axis=0)
    yield "twin difference, median, AB and CD (m)", f"{observed:.2f}, {counterfactual:.2f}"
    yield "do-operation has an effect: on a remaining object", f"{share_with_effect(arrays, spec):.1%}"
    yield "… on one that is not displaced", f"{share_with_effect(arrays, spec, on_changed_object=False):.1%}"
    for number, cell in enumerate(spec.scenario.cells()):
        yield f"cell {cell}", f"{(arrays['cell'] == number).mean():.1%}"
    if spec.scenario.statics is not None:
        yield from tower_outcomes(arrays, spec, spec.scenario.statics.fallen_distance)
    with Simulator() as simulator:
        yield f"CPU-s per experiment, of {SAMPLE} regenerated", f"{seconds(spec, simulator):.3f}"
        yield f"simulations per experiment, of {SAMPLE} regenerated", f"{simulator.num_simulations / SAMPLE:.2f}"
        yield from convergence(arrays, spec, simulator)


def convergence(arrays: Arrays, spec: DatasetSpec, simulator: Simulator) -> Lines:
    """Yield how far D changes, as an MSE with its standard error, if the solver's rate is doubled and doubled again."""
    scenario, starts, paths = spec.scenario, [], []
    count = min(NUM_CONVERGENCE, spec.num_experiments)
    for row in np.linspace(0, spec.num_experiments - 1, count).astype(int).tolist():
        starts.append(scenes_of(arrays, row, scenario)[1])
    for times in (1, 2, 4):
        solver = replace(scenario.solver, step_rate_hz=times * scenario.solver.step_rate_hz)
        paths.append([replace(scenario, solver=solver).simulate(simulator, start) for start in starts])
    for times, coarse, fine in zip((1, 2), paths, paths[1:], strict=False):
        error = [squared_distance(*both, scenario) for both in zip(coarse, fine, strict=True)]
        text = f"{np.mean(error):.4f} ± {np.std(error, ddof=1) / np.sqrt(len(error)):.4f}"
        yield f"MSE of D, {times}× to {2 * times}× the solver's rate, of {len(error)} (m²)", text
    if scenario.statics is not None:
        standing = np.array([[scenario.statics.stands(path) for path in each] for each in paths])
        yield "CD that stand, or fall, at all three rates", f"{np.mean((standing == standing[0]).all(axis=0)):.1%}"


def squared_distance(coarse: Trajectory, fine: Trajectory, scenario: Scenario) -> float:
    """Return the MSE between two D, m², as of a prediction."""
    stride, dims = scenario.clock.states_per_frame, scenario.task.metric_dims
    difference = (coarse.positions - fine.positions)[stride::stride, coarse.presence, :dims]
    return float(np.square(difference).mean())


def copy_baselines(arrays: Arrays, spec: DatasetSpec) -> Lines:
    """Yield MSE and twin difference explained, with 95 % intervals over clusters."""
    clusters = clusters_of(spec, arrays["experiment"])
    batch, dims = to_batch(arrays, spec.scenario), spec.scenario.task.metric_dims
    for name, model in (("copy C", CopyC()), ("copy B", CopyB())):
        stored = prediction_arrays(model(batch.inputs), batch.targets, np.arange(len(batch)), clusters)
        scores = score(Predictions.from_arrays(stored), Truth.from_arrays(stored, metric_dims=dims))
        for measure, title, digits in (
            ("mse", "MSE", 3),
            ("twin_difference_explained", "twin difference explained", 2),
        ):
            values = scores.values[measure]
            low, high = interval(values, scores.cluster)
            yield f"{name}, {title}", f"{mean(values):.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def tower_outcomes(arrays: Arrays, spec: DatasetSpec, fallen_distance: float) -> Lines:
    """Yield how far standing towers creep, and the share of CD that stand per value of every confounder.

    The share is a range over all heights for confounders of objects.
    """
    stand, grid = stands(arrays, fallen_distance), spec.scenario.confounders
    distance = np.linalg.norm(arrays["states"][..., :3] - arrays["states"][:, :, :1, :, :3], axis=-1).max(axis=(2, 3))
    creep = 1000 * distance[stand]
    yield f"creep of {creep.size} towers that stand: median, largest (mm)", f"{np.median(creep):.1f}, {creep.max():.0f}"
    standing = stand[:, 1]
    slots = slots_in_order(arrays, spec.num_objects)
    for name in ("mass", "friction"):
        object_values = np.take_along_axis(arrays[name], slots, axis=1).T
        for value in getattr(grid, name):
            shares = [standing[np.isclose(object_value, value)].mean() for object_value in object_values]
            yield f"CD stands, {name} {value:g}", f"{min(shares):.1%} to {max(shares):.1%}"
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        for value in getattr(grid, name):
            yield (
                f"CD stands, {name} {value:g}",
                f"{standing[np.isclose(arrays['gravity'][:, axis], value)].mean():.1%}",
            )


def seconds(spec: DatasetSpec, simulator: Simulator) -> float:
    """Return the CPU-seconds per experiment of searching and simulating the first ones."""
    start = time.process_time()
    for pair in range(SAMPLE // 2):
        spec.scenario.twin_pair(spec.num_objects, data_seed=spec.data_seed, pair=pair, simulator=simulator)
    return (time.process_time() - start) / SAMPLE


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*", help="as of src/generate.py: scenario=balls size=small")
    main(*parser.parse_args().overrides)
