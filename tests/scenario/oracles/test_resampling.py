"""What could be without AB, with and without what is given besides."""

from itertools import count

import numpy as np
import pytest

from cophy.dataset.states import do_operation_of, scene_of
from cophy.errors import CophyError
from cophy.oracles import posterior
from cophy.oracles.posterior import resample
from cophy.scenario import Simulator
from cophy.scenario.simulator import CachingSimulator


def asked(tiny, row: int = 0) -> tuple:
    spec, arrays = tiny
    return spec.scenario, scene_of(arrays, row, spec.scenario), do_operation_of(arrays, row, spec.scenario)


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
    assert found["nothing"].draw.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]  # twins are of one draw
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

        monkeypatch.setattr(posterior, "MAX_TRIES", 10)
        monkeypatch.setattr(type(scenario), "simulate_twins", rarely)
        drawing = {"draws": 8, "rng": np.random.default_rng(0), "simulator": simulator}
        if is_found:
            assert len(resample(scenario, pair[0].scene, pair[0].do_operation, **drawing).counterfactuals) == 8
        else:
            with pytest.raises(CophyError, match="no balls twins fit this scene in 10 tries"):
                resample(scenario, pair[0].scene, pair[0].do_operation, **drawing)
