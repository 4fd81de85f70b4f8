"""What the oracles take for possible: known cases by hand, and inference where the truth is known."""

import numpy as np
import pytest

from cophy.dataset.replay import do_operation_of, scene_of
from cophy.scenario import Scene, Simulator
from cophy.scenario.oracles.posterior import counterfactual_hypotheses, feedforward_hypotheses


def observed(arrays: dict, row: int, stride: int) -> np.ndarray:
    return arrays["states"][row, 0, ::stride, :, :3].astype(np.float64)


def test_ab_narrows_down_what_d_could_be(tiny, simulator: Simulator) -> None:
    spec, arrays = tiny
    scenario, stride = spec.scenario, spec.scenario.clock.states_per_frame
    error = {"without": [], "with": []}
    for row in range(4):
        scene, do_operation = scene_of(arrays, row, scenario), do_operation_of(arrays, row, scenario)
        asked = {"draws": 6, "rng": np.random.default_rng(row), "simulator": simulator}
        found = {
            "without": feedforward_hypotheses(scenario, scene, do_operation, **asked),
            "with": counterfactual_hypotheses(
                scenario, scene, do_operation, observed(arrays, row, stride), noise=0.05, **asked
            ),
        }
        true, present = arrays["states"][row, 1, ..., :3], arrays["presence"][row, 1]
        for name, hypotheses in found.items():
            weights = [hypothesis.weight for hypothesis in hypotheses]
            mean = np.average([h.counterfactual.positions for h in hypotheses], axis=0, weights=weights)
            error[name].append(np.square(mean - true)[:, present].mean())
        assert len(found["without"]) == 6
    assert np.mean(error["with"]) < 0.5 * np.mean(error["without"])


def test_oracles_do_not_look_at_confounders_or_velocities(tiny, simulator: Simulator) -> None:
    spec, arrays = tiny
    if spec.scenario.name == "balls":
        pytest.skip("as collision, and slower")
    scenario, stride = spec.scenario, spec.scenario.clock.states_per_frame
    scene, do_operation = scene_of(arrays, 0, scenario), do_operation_of(arrays, 0, scenario)
    disguised = scenario.under(0, scene.at_rest())

    def answers(of: Scene) -> list[float]:
        asked = {"draws": 4, "simulator": simulator}
        found = feedforward_hypotheses(scenario, of, do_operation, rng=np.random.default_rng(0), **asked)
        seen = observed(arrays, 0, stride)
        found += counterfactual_hypotheses(
            scenario, of, do_operation, seen, noise=0.05, rng=np.random.default_rng(0), **asked
        )
        return [float(h.counterfactual.positions.sum()) for h in found]

    assert answers(scene) == answers(disguised)
