"""What a generated dataset asks of a model, without any: python benchmarks/dataset/data_report.py scenario=balls size=small

Takes what generate.py takes, and prints a Markdown table with a column per dataset. Copies are judged on all experiments.
"""

import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator

import numpy as np
import pandas as pd

from cophy.audit.data import matters, slots_in_order
from cophy.audit.simulated import moved_by_twice_the_rate
from cophy.bootstrap import interval, mean
from cophy.config import generated_by, settings
from cophy.dataset.difficulty import twin_differences
from cophy.dataset.features import stands, to_batch
from cophy.dataset.spec import DatasetSpec
from cophy.models.baselines import CopyB, CopyC
from cophy.scenario import Simulator
from cophy.schemas import register
from cophy.training.evaluation import evaluate

Arrays = dict[str, np.ndarray]
Lines = Iterator[tuple[str, str]]  # name of a number, and the number

SAMPLE = 40  # experiments that are simulated again, and made again


def main(*overrides: str) -> None:
    """Print the table; the datasets must be there."""
    register()
    columns = {}
    for states in generated_by(settings("generate", *overrides)):
        columns[f"{states.spec.scenario.name}, {states.spec.num_objects}"] = dict(lines(states.load(), states.spec))
    print(pd.DataFrame(columns).fillna("—").to_markdown())


def lines(arrays: Arrays, spec: DatasetSpec) -> Lines:
    """All numbers of a dataset."""
    yield "experiments", str(spec.num_experiments)
    yield from of_copies(arrays, spec)
    observed, counterfactual = np.median(twin_differences(arrays), axis=0)
    yield "twin difference, median, AB and CD (m)", f"{observed:.2f}, {counterfactual:.2f}"
    yield "do-operation matters: to a remaining object", f"{matters(arrays, spec, acted_on=True):.1%}"
    yield "… to one that it does not act on", f"{matters(arrays, spec, acted_on=False):.1%}"
    for number, cell in enumerate(spec.scenario.cells()):
        yield f"cell {cell}", f"{(arrays['cell'] == number).mean():.1%}"
    if spec.scenario.statics is not None:
        yield from of_outcomes(arrays, spec, spec.scenario.statics.fallen_distance)
    yield "simulations per experiment", f"{arrays['pair_simulations'][::2].sum() / spec.num_experiments:.2f}"
    with Simulator() as simulator:
        yield f"CPU-s per experiment, of {SAMPLE} made again", f"{seconds(spec, simulator):.3f}"
        rows = np.linspace(0, spec.num_experiments - 1, SAMPLE).astype(int).tolist()
        changes = np.quantile(moved_by_twice_the_rate(arrays, spec, rows, simulator), (0.5, 0.9))
        yield f"CD with the solver's rate doubled, of {SAMPLE}: median, 90 % (m)", "{:.3f}, {:.3f}".format(*changes)


def of_copies(arrays: Arrays, spec: DatasetSpec) -> Lines:
    """MSE and twin difference explained, with 95 % intervals over twin pairs."""
    batch, scenario = to_batch(arrays, spec.scenario), spec.scenario
    for name, model in (("copy C", CopyC()), ("copy B", CopyB())):
        measured = evaluate(model(batch.inputs), batch.targets, scenario)
        for measure, title, digits in (
            ("mse", "MSE", 3),
            ("twin_difference_explained", "twin difference explained", 2),
        ):
            values = measured[measure]
            low, high = interval(values, batch.targets.pair.numpy())
            yield f"{name}, {title}", f"{mean(values):.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def of_outcomes(arrays: Arrays, spec: DatasetSpec, fallen_distance: float) -> Lines:
    """Share of CD that stand, for every value of every confounder; of objects, over all heights: smallest to largest."""
    standing, grid = stands(arrays, fallen_distance)[:, 1], spec.scenario.confounders
    slots = slots_in_order(arrays, spec.num_objects)
    for name in ("mass", "friction"):
        of_objects = np.take_along_axis(arrays[name], slots, axis=1).T
        for value in getattr(grid, name):
            shares = [standing[np.isclose(of_object, value)].mean() for of_object in of_objects]
            yield f"CD stands, {name} {value:g}", f"{min(shares):.1%} to {max(shares):.1%}"
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        for value in getattr(grid, name):
            yield (
                f"CD stands, {name} {value:g}",
                f"{standing[np.isclose(arrays['gravity'][:, axis], value)].mean():.1%}",
            )


def seconds(spec: DatasetSpec, simulator: Simulator) -> float:
    """CPU-s per experiment of searching and simulating the first ones again."""
    start = time.process_time()
    for pair in range(SAMPLE // 2):
        spec.scenario.twin_pair(spec.num_objects, data_seed=spec.data_seed, pair=pair, simulator=simulator)
    return (time.process_time() - start) / SAMPLE


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*", help="as of src/generate.py: scenario=balls size=small")
    main(*parser.parse_args().overrides)
