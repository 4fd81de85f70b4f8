"""What D could be with and without AB, against closed forms and sums over all configurations."""

from collections.abc import Callable
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from cophy.dataset.states import build_scene, do_operation_of
from cophy.errors import CophyError
from cophy.oracles.posterior import ConfigurationSearch, Outcomes, posterior, resample
from cophy.scenario import Experiment, Scenario, Scene, Simulator, Trajectory
from cophy.scenario.simulator import CachingSimulator


def trajectory(x: float) -> Trajectory:
    """One object, at rest."""
    states = np.zeros((1, 1, 13))
    states[..., 0] = x
    return Trajectory(states, np.ones(1, dtype=bool))


def test_what_is_enumerated_has_a_weighted_mean_and_no_variance() -> None:
    hypotheses = Outcomes([trajectory(0.0), trajectory(4.0)], np.array([0.75, 0.25]))
    assert hypotheses.mean(hypotheses.states)[0, 0, 0] == 1.0
    assert (hypotheses.variance_of_mean(hypotheses.states) == 0).all()


def test_the_variance_of_a_mean_is_that_of_independent_draws() -> None:
    hypotheses = Outcomes.drawn([[trajectory(x)] for x in (1.0, 2.0, 3.0)])
    assert hypotheses.mean(hypotheses.states)[0, 0, 0] == pytest.approx(2.0)
    assert hypotheses.variance_of_mean(hypotheses.states)[0, 0, 0] == pytest.approx(1.0 / 3)


def test_the_squared_error_without_the_variance_is_that_of_the_exact_mean() -> None:
    """D is normal with variance 1, so that the MSE of the exact mean is 1; a mean of so few draws is far from it."""
    rng, unbiased, naive, alike = np.random.default_rng(0), [], [], 0.9
    for _ in range(2000):
        shared, independent = rng.normal(size=(4, 1)), rng.normal(size=(4, 2))
        twins = np.sqrt(alike) * shared + np.sqrt(1 - alike) * independent
        hypotheses = Outcomes.drawn([[trajectory(x) for x in pair] for pair in twins.tolist()])
        error = (hypotheses.mean(hypotheses.states)[0, 0, 0] - rng.normal()) ** 2
        naive.append(error)
        unbiased.append(error - hypotheses.variance_of_mean(hypotheses.states)[0, 0, 0])
    assert np.mean(naive) == pytest.approx(1 + (1 + alike) / 8, abs=0.1)
    assert np.mean(unbiased) == pytest.approx(1.0, abs=0.1)


ASKED = {"draws": 4, "max_configurations": 300, "noise": 0.05}


def with_ab(scenario: Scenario, twin: Experiment, simulator: Simulator) -> Outcomes:
    seen = twin.observed.positions[:: scenario.clock.states_per_frame]
    rng = np.random.default_rng(0)
    return posterior(scenario, twin.scene, twin.do_operation, seen, **ASKED, rng=rng, simulator=simulator)


@pytest.mark.parametrize(("name", "num_objects"), [("blocktower", 3), ("balls", 2)])
def test_ab_narrows_down_what_d_could_be(name: str, num_objects: int, scenario_of) -> None:
    scenario = scenario_of(name)
    with CachingSimulator() as simulator:
        twins = scenario.twin_pair(num_objects, data_seed=0, pair=0, simulator=simulator)
        asked = {"draws": 4, "rng": np.random.default_rng(0), "simulator": simulator}
        without = resample(scenario, twins[0].scene, twins[0].do_operation, **asked)
        errors = [
            [error(hypotheses, twin) for hypotheses in (without, with_ab(scenario, twin, simulator))] for twin in twins
        ]
    of_without, of_with = np.mean(errors, axis=0)
    assert of_with < 0.2 * of_without


def error(hypotheses: Outcomes, twin: Experiment) -> float:
    """Mean squared error of the mean of D, m²."""
    difference = hypotheses.mean(hypotheses.states[..., :3]) - twin.counterfactual.positions
    return float(np.square(difference)[:, twin.counterfactual.presence].mean())


def test_the_true_configuration_explains_ab(scenario_of) -> None:
    scenario = scenario_of("collision", "confounders=text")
    for pair in (0, 1):
        with CachingSimulator() as simulator:
            for twin in scenario.twin_pair(2, data_seed=0, pair=pair, simulator=simulator):
                hypotheses = with_ab(scenario, twin, simulator)
                assert hypotheses.draw is None
                found = [np.array_equal(d.states, twin.counterfactual.states) for d in hypotheses.counterfactuals]
                assert hypotheses.weight[found].sum() >= 1 / 16


def test_confounders_are_not_looked_at(scenario_of) -> None:
    scenario = scenario_of("collision", "confounders=text")
    with CachingSimulator() as simulator:
        twin, _ = scenario.twin_pair(2, data_seed=0, pair=0, simulator=simulator)
        disguised = replace(twin, scene=scenario.with_configuration(0, twin.scene), configuration=0)
        first, second = (with_ab(scenario, each, simulator) for each in (twin, disguised))
    assert np.array_equal(first.states, second.states)
    assert np.array_equal(first.weight, second.weight)


NOISE = 0.05
TEXT = [
    "scenario.confounders.mass=[1,10]",
    "scenario.confounders.friction=[0.5,1]",
    "scenario.confounders.restitution=[1]",
]
RELEASED = [f"scenario.confounders.{name}=[{values}]" for name, values in
            (("mass", "1,2,5"), ("friction", "0.1,0.5,1"), ("restitution", "0.1,0.5,1"))]  # fmt: skip


def rolling(scenario: Scenario) -> Scene:
    """Two balls, one of which rolls into the other."""
    scene = scenario.sample_scene(0, (0, 1), np.random.default_rng(0))
    placed = [(-1.5, 0.0), (0.5, 0.2)]
    for body, (x, y) in zip(scene.objects, placed, strict=True):
        scene = scene.with_object(type(body)(**{**vars(body), "position": (x, y, 0.5)}))
    return scene.with_velocities(np.array([[4.0, 0.0], [0.0, 0.5]]))


@pytest.fixture
def searched(scenario_of, simulator: Simulator) -> Callable[..., tuple[ConfigurationSearch, np.ndarray]]:
    """A search whose AB is that of a configuration; and the squared errors of all configurations, m²."""

    def make(configuration: int, *overrides: str, brute: bool = True) -> tuple[ConfigurationSearch, np.ndarray]:
        scenario = scenario_of("balls", "scenario.clock.num_frames=12", *overrides)
        scene, stride = rolling(scenario), scenario.clock.states_per_frame
        count = scenario.confounders.num_configurations(2)

        def frames(c: int) -> np.ndarray:
            return scenario.simulate(simulator, scenario.with_configuration(c, scene)).positions[::stride]

        observed = frames(configuration)
        search = ConfigurationSearch(
            scenario,
            scene,
            observed,
            np.full(count, 1 / count),
            noise=NOISE,
            with_velocities=lambda moving: moving,
            simulator=simulator,
        )
        squared = [np.square(frames(c) - observed)[:, :2].sum() for c in range(count if brute else 0)]
        return search, np.array(squared)

    return make


def test_the_likelihood_is_that_of_independent_errors(searched) -> None:
    search, squared = searched(5, *TEXT)
    found = {each.log_probability for each in search.enumerated(search.alike_at_first(range(16)))}
    expected = -np.log(16) - squared / (2 * NOISE**2)
    likely = expected[expected > expected.max() - np.log(100)]
    np.testing.assert_allclose(sorted(found), sorted(set(likely.tolist())), atol=1e-9)


def test_what_early_frames_rule_out_would_not_have_mattered(searched, simulator: Simulator) -> None:
    spent = 0
    for configuration in (0, 15):
        search, squared = searched(configuration, *TEXT)
        posterior = np.exp(-squared / (2 * NOISE**2))
        before = simulator.num_simulations
        found = search.enumerated(search.alike_at_first(range(16)))
        assert len(found) == (posterior > 0.01 * posterior.max()).sum()
        spent += simulator.num_simulations - before
    assert spent < 2 * (4 * 16)  # not all are compared with all frames: two AB, four lengths


def test_a_search_over_many_finds_what_explains_ab(searched, simulator: Simulator) -> None:
    search, _ = searched(444, *RELEASED, brute=False)
    before = simulator.num_simulations
    found = search.searched(np.random.default_rng(0).choice(729, 12).tolist(), 300)
    coordinates = 3 * 2 * 11  # each of which may be off by the noise
    assert max(each.log_probability for each in found) + np.log(729) > -coordinates / 2
    assert simulator.num_simulations - before <= 3 * (300 // 3 + 12)


def test_what_is_impossible_is_not_tried(searched, monkeypatch: pytest.MonkeyPatch) -> None:
    search, _ = searched(5, *TEXT)
    possible = [1, 3, 5]  # 1 is a neighbour of the two others
    search.prior[:] = 0.0
    search.prior[possible] = 1 / 3
    tried, log_probability = set(), search._log_probability

    def record(configuration: int, num_frames: int) -> float:
        tried.add(configuration)
        return log_probability(configuration, num_frames)

    monkeypatch.setattr(search, "_log_probability", record)
    search.searched([3], 60)
    assert tried == set(possible)


def asked(tiny, row: int = 0) -> tuple:
    spec, arrays = tiny
    return spec.scenario, build_scene(arrays, row, spec.scenario), do_operation_of(arrays, row, spec.scenario)


def at_start(hypotheses) -> np.ndarray:
    """(hypothesis, slot, 2) horizontal velocities in C."""
    return hypotheses.states[:, 0, :, 7:9]


def test_what_is_given_is_held_and_the_rest_is_drawn(tiny, simulator: Simulator) -> None:
    scenario, scene, do_operation = asked(tiny)
    configuration = int(tiny[1]["configuration"][0])
    told = {"nothing": {}, "velocity": {"velocity_known": True}, "confounders": {"configuration": configuration}}
    found = {
        name: resample(
            scenario, scene, do_operation, draws=8, rng=np.random.default_rng(0), simulator=simulator, **known
        )
        for name, known in told.items()
    }
    for hypotheses in found.values():
        assert hypotheses.weight.sum() == pytest.approx(1.0)
    if scenario.statics is not None:  # towers start at rest
        assert np.array_equal(found["velocity"].states, found["nothing"].states)
        assert found["confounders"].draw is None
        (only,) = found["confounders"].counterfactuals
        exact = scenario.simulate(simulator, do_operation.apply(scenario.with_configuration(configuration, scene)))
        assert np.array_equal(only.states, exact.states)
        return
    true = np.zeros((scenario.num_slots, 2))
    for body in do_operation.apply(scene).objects:
        true[body.slot] = body.linear_velocity[:2]
    assert len(found["nothing"].counterfactuals) == len(found["velocity"].counterfactuals) == 8
    assert np.abs(at_start(found["velocity"]) - true).max() < 1e-9
    assert found["nothing"].draw.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]  # twins share a draw
    assert found["confounders"].draw.tolist() == [0, 1, 2, 3]
    if scenario.name == "balls":  # of collisions, A may tell how they start
        for name in ("nothing", "confounders"):
            assert (np.abs(at_start(found[name]) - true).max(axis=(1, 2)) > 0.01).all()


@pytest.mark.parametrize("name", ["collision"])
def test_what_is_drawn_meets_the_conditions_of_the_search(name: str, scenario_of, monkeypatch) -> None:
    scenario, rng = scenario_of(name), np.random.default_rng(1)
    with CachingSimulator() as simulator:
        pair = scenario.twin_pair(2, data_seed=0, pair=0, simulator=simulator)
        scene, do_operation = pair[0].scene, pair[0].do_operation
        asked, accepted = [], []
        condition = type(scenario).simulate_twins

        def watched(self, scenes, simulator, observed=None):
            found = condition(self, scenes, simulator, observed)
            asked.append(observed is not None)
            if observed is not None and found is not None:
                accepted.extend(found)
            return found

        monkeypatch.setattr(type(scenario), "simulate_twins", watched)
        found = resample(scenario, scene, do_operation, draws=6, rng=rng, simulator=simulator)
    assert [id(each) for each in found.counterfactuals] == [id(each) for each in accepted]
    assert not asked[0]


@pytest.mark.parametrize(("fits", "is_found"), [(10, True), (11, False)])
def test_rare_twins_are_searched_for_as_long_as_one_more_is_found_in_time(
    fits: int, is_found: bool, scenario_of, monkeypatch
) -> None:
    """One ball that is left alone hardly tells twins apart: every pair may take long, and all pairs longer."""
    scenario, tries = scenario_of("balls"), count(1)
    with Simulator() as simulator:
        pair = scenario.twin_pair(2, data_seed=0, pair=0, simulator=simulator)
        kept = pair[0].counterfactual, pair[1].counterfactual

        def rarely(self, scenes, simulator, observed=None):
            return kept if observed is not None or next(tries) % fits == 0 else None

        monkeypatch.setattr("cophy.oracles.posterior.MAX_TRIES", 10)
        monkeypatch.setattr(type(scenario), "simulate_twins", rarely)
        drawing = {"draws": 8, "rng": np.random.default_rng(0), "simulator": simulator}
        if is_found:
            assert len(resample(scenario, pair[0].scene, pair[0].do_operation, **drawing).counterfactuals) == 8
        else:
            with pytest.raises(CophyError, match="no balls twins fit this scene in 10 tries"):
                resample(scenario, pair[0].scene, pair[0].do_operation, **drawing)
