"""What D could be with AB, where the truth is known."""

import numpy as np

from cophy.dataset.replay import do_operation_of, scene_of
from cophy.scenario import Simulator
from cophy.scenario.oracles.hypotheses import Hypotheses
from cophy.scenario.oracles.posterior import posterior
from cophy.scenario.oracles.resampling import resample
from cophy.scenario.physics.remembering_simulator import RememberingSimulator

ASKED = {"draws": 4, "max_configurations": 800, "noise": 0.05}


def with_ab(tiny, row: int, simulator: Simulator, *, disguised: bool = False, draws: int = 4) -> Hypotheses:
    spec, arrays = tiny
    scenario, stride = spec.scenario, spec.scenario.clock.states_per_frame
    scene = scene_of(arrays, row, scenario)
    return posterior(
        scenario,
        scenario.under(0, scene) if disguised else scene,
        do_operation_of(arrays, row, scenario),
        arrays["states"][row, 0, ::stride, :, :3].astype(np.float64),
        **ASKED | {"draws": draws},
        rng=np.random.default_rng(row),
        simulator=simulator,
    )


def test_ab_narrows_down_what_d_could_be(tiny) -> None:
    spec, arrays = tiny
    error = {"without": [], "with": []}
    for row in (0, 1) if spec.scenario.statics is None else (0,):
        with RememberingSimulator() as simulator:
            scene, do_operation = scene_of(arrays, row, spec.scenario), do_operation_of(arrays, row, spec.scenario)
            asked = {"draws": 4, "rng": np.random.default_rng(row), "simulator": simulator}
            found = {
                "without": resample(spec.scenario, scene, do_operation, **asked),
                "with": with_ab(tiny, row, simulator),
            }
        true, present = arrays["states"][row, 1, ..., :3], arrays["presence"][row, 1]
        for name, hypotheses in found.items():
            mean = hypotheses.mean(hypotheses.states[..., :3])
            error[name].append(np.square(mean - true)[:, present].mean())
    assert np.mean(error["with"]) < 0.5 * np.mean(error["without"])


def test_the_true_configuration_explains_ab(tiny_collision) -> None:
    spec, arrays = tiny_collision
    for row in range(2):
        with RememberingSimulator() as simulator:
            hypotheses = with_ab(tiny_collision, row, simulator, draws=729)  # all, so none is drawn
            assert hypotheses.draw is None
            true = spec.scenario.under(int(arrays["configuration"][row]), scene_of(arrays, row, spec.scenario))
            true = spec.scenario.simulate(simulator, do_operation_of(arrays, row, spec.scenario).apply(true))
        same = [np.array_equal(each.states, true.states) for each in hypotheses.counterfactuals]
        assert hypotheses.weight[same].sum() >= 0.01 * hypotheses.weight.max()


def test_confounders_are_not_looked_at(tiny_collision) -> None:
    with RememberingSimulator() as simulator:
        plain, disguised = (with_ab(tiny_collision, 0, simulator, disguised=hidden) for hidden in (False, True))
    assert np.array_equal(plain.states, disguised.states)
    assert np.array_equal(plain.weight, disguised.weight)
