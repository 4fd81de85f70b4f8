"""How much of the error of the oracle without AB is its number of draws: python benchmarks/oracle_draws.py SCENARIO OBJECTS

Draws anew what `oracle_feedforward` draws for the test split at size=small. Of two independent means m and n of as many draws,
(m - D)(n - D) is in expectation the squared error of the exact mean. With balls of four it takes a quarter of an hour on one core.
"""

import sys

import numpy as np
from measure import ROOT, settings
from tqdm import tqdm

from cophy import config
from cophy.dataset.oracles import OracleForecasts, OracleSettings
from cophy.dataset.replay import do_operation_of, scene_of
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.intervals import interval
from cophy.scenario import Simulator
from cophy.scenario.hypotheses import without_observation


def main(name: str, num_objects: int) -> None:
    """Needs the dataset and its forecasts."""
    config.register()
    chosen = settings("train", f"scenario={name}", "model=oracle_feedforward")
    scenario, asked = chosen.scenario, OracleSettings(chosen.model.draws, chosen.model.noise)
    states = States(DatasetSpec(scenario, num_objects, chosen.size, 0), ROOT / "data")
    stored, arrays = OracleForecasts(states, asked).load(), states.load()
    rows, dims, stride = stored["experiment"], scenario.task.metric_dims, scenario.clock.states_per_frame
    exact, found = [], []
    with Simulator() as simulator:
        for index, row in enumerate(tqdm(rows.tolist())):
            if index % 2 == 0:  # twins share the forecast
                drawn = without_observation(
                    scenario,
                    scene_of(arrays, row, scenario),
                    do_operation_of(arrays, row),
                    draws=asked.draws,
                    rng=np.random.default_rng((2, row)),
                    simulator=simulator,
                )
                again = np.mean([each.counterfactual.positions[::stride][1:] for each in drawn], axis=0)
            present = arrays["presence"][row, 1]
            true = arrays["states"][row, 1, ::stride, :, :3][1:]
            first, second = (
                (mean - true)[:, present, :dims] for mean in (stored["feedforward_position"][index], again)
            )
            found.append(float(np.square(first).mean()))
            exact.append(float((first * second).mean()))
    for what, errors in (("as it is", found), ("with endlessly many draws", exact)):
        low, high = interval(np.array(errors), arrays["twin"][rows])
        print(f"{what}: MSE {np.mean(errors):.3f} [{low:.3f}, {high:.3f}]")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
