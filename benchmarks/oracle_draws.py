"""How much of the error of the oracle without AB is its number of draws: python benchmarks/oracle_draws.py SCENARIO OBJECTS [data_dir]

Draws anew what `oracle_feedforward` draws for the test split at size=small. Of two independent means m and n of as many draws,
(m - D)(n - D) is in expectation the squared error of the exact mean. With balls of four it takes a quarter of an hour on one core.
"""

import sys
from pathlib import Path

import numpy as np
from tqdm import tqdm

from cophy.app.composition import settings
from cophy.app.registration import register
from cophy.bootstrap import interval
from cophy.dataset.replay import do_operation_of, scene_of
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.store.experiment_set import OracleSettings
from cophy.dataset.store.states import States
from cophy.scenario import Scenario, Simulator
from cophy.scenario.oracles.posterior import feedforward_hypotheses


def main(name: str, num_objects: int, data_dir: Path) -> None:
    """Print both errors; needs the dataset and its forecasts.

    Args:
        name: Of the scenario.
        num_objects: In every experiment.
        data_dir: Where the dataset lies.
    """
    register()
    chosen = settings("train", f"scenario={name}", "model=oracle_feedforward")
    oracle = OracleSettings(chosen.model.draws, chosen.model.noise)
    states = States(DatasetSpec(chosen.scenario, num_objects, chosen.size, chosen.data_seed), data_dir)
    stored, arrays = states.forecasts(oracle).load(), states.load()
    rows = stored["experiment"]
    again = drawn_again(chosen.scenario, arrays, rows, oracle.draws)
    exact, found = [], []
    for row, first_mean, second_mean in zip(rows, stored["feedforward_position"], again, strict=True):
        first, second = (error(mean, arrays, row, chosen.scenario) for mean in (first_mean, second_mean))
        found.append(float(np.square(first).mean()))
        exact.append(float((first * second).mean()))
    for what, errors in (("as it is", found), ("with endlessly many draws", exact)):
        low, high = interval(np.array(errors), arrays["twin"][rows])
        print(f"{what}: MSE {np.mean(errors):.3f} [{low:.3f}, {high:.3f}]")


def drawn_again(scenario: Scenario, arrays: dict[str, np.ndarray], rows: np.ndarray, draws: int) -> list[np.ndarray]:
    """Forecasts without AB that are independent of the stored ones.

    Args:
        scenario: Of the dataset.
        arrays: The dataset.
        rows: Experiments of the test split, twins one after the other.
        draws: To a forecast.

    Returns:
        (step, slot, 3) mean positions in D, metres, of every row; twins share theirs.
    """
    forecasts = []
    with Simulator() as simulator:
        for row in tqdm(rows[::2].tolist()):
            drawn = feedforward_hypotheses(
                scenario,
                scene_of(arrays, row, scenario),
                do_operation_of(arrays, row, scenario),
                draws=draws,
                rng=np.random.default_rng((2, row)),
                simulator=simulator,
            )
            stride = scenario.clock.states_per_frame
            forecasts += 2 * [np.mean([each.counterfactual.positions[::stride][1:] for each in drawn], axis=0)]
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
    return np.asarray((mean - true)[:, arrays["presence"][row, 1], : scenario.task.metric_dims])


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3] if len(sys.argv) > 3 else "data"))
