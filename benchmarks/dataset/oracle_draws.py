"""How much of the error of the oracle without AB is its number of draws: python benchmarks/dataset/oracle_draws.py SCENARIO OBJECTS [data_dir]

Draws anew what `oracle_feedforward` draws for the test split at size=small. Of two independent means m and n of as many draws,
(m - D)(n - D) is in expectation the squared error of the exact mean, whatever the variance that is stored beside m.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import numpy as np
from tqdm import tqdm

from cophy.bootstrap import interval
from cophy.config import settings
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.oracles.forecasts import forecast_of
from cophy.oracles.posterior import resample
from cophy.scenario import Scenario, Simulator
from cophy.schemas import register


def main(name: str, num_objects: int, data_dir: Path) -> None:
    """Print the error as it is, without what is taken out for the draws, and by two independent means; needs the forecasts.

    Args:
        name: Of the scenario.
        num_objects: In every experiment.
        data_dir: Where the dataset lies.
    """
    register()
    chosen = settings("train", f"scenario={name}", "model=oracle_feedforward")
    asked = chosen.model.settings
    spec = DatasetSpec(chosen.scenario, num_objects, chosen.size, chosen.data_seed)
    states = States(spec, data_dir)
    stored, arrays = states.forecasts(asked).load(), states.load()
    rows = stored["experiment"]
    again = drawn_again(spec, rows, asked.draws)
    errors: dict[str, list[float]] = {"as it is": [], "without the variance": [], "by two means": []}
    for row, mean, variance, other in zip(
        rows, stored["feedforward_position"], stored["feedforward_draw_variance"], again, strict=True
    ):
        first, second = (error(each, arrays, row, chosen.scenario) for each in (mean, other))
        by_chance = counted(variance, arrays, row, chosen.scenario)
        errors["as it is"].append(float(np.square(first).mean()))
        errors["without the variance"].append(float((np.square(first) - by_chance).mean()))
        errors["by two means"].append(float((first * second).mean()))
    for what, found in errors.items():
        low, high = interval(np.array(found), arrays["twin"][rows])
        print(f"{what}: MSE {np.mean(found):.3f} [{low:.3f}, {high:.3f}]")


def drawn_again(spec: DatasetSpec, rows: np.ndarray, draws: int) -> list[np.ndarray]:
    """Forecasts without AB that are independent of the stored ones.

    Args:
        spec: Of the dataset.
        rows: Experiments of the test split, twins one after the other.
        draws: To a forecast.

    Returns:
        (step, slot, 3) mean positions in D, metres, of every row; twins share theirs.
    """
    forecasts = []
    with Simulator() as simulator:
        for pair in tqdm((rows[::2] // 2).tolist()):
            twin, _ = spec.scenario.twin_pair(
                spec.num_objects, data_seed=spec.data_seed, pair=pair, simulator=simulator
            )
            rng = np.random.default_rng((4, pair))
            drawn = resample(spec.scenario, twin.scene, twin.do_operation, draws=draws, rng=rng, simulator=simulator)
            forecasts += 2 * [forecast_of(drawn, spec.scenario)["position"]]
    return forecasts


def error(mean: np.ndarray, arrays: dict[str, np.ndarray], row: int, scenario: Scenario) -> np.ndarray:
    """What is off in a forecast, at every step.

    Args:
        mean: (step, slot, 3) forecast positions in D, metres.
        arrays: The dataset.
        row: The experiment.
        scenario: Says which coordinates count.

    Returns:
        (step, object, coordinate) metres, of the objects that are there.
    """
    true = arrays["states"][row, 1, :: scenario.clock.states_per_frame, :, :3][1:]
    return counted(mean - true, arrays, row, scenario)


def counted(values: np.ndarray, arrays: dict[str, np.ndarray], row: int, scenario: Scenario) -> np.ndarray:
    """The coordinates that count, of the objects that are there: (step, slot, 3) to (step, object, coordinate)."""
    return np.asarray(values[:, arrays["presence"][row, 1], : scenario.task.metric_dims])


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("name", metavar="scenario")
    parser.add_argument("num_objects", type=int, metavar="objects", help="in every experiment")
    parser.add_argument("data_dir", nargs="?", type=Path, default=Path("data"), help="where the dataset lies")
    main(**vars(parser.parse_args()))
