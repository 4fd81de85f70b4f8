from collections.abc import Callable

import numpy as np
import pytest

from cophy.errors import CophyError
from cophy.oracles.posterior import posterior, resample
from cophy.scenario import Scenario, Simulator
from cophy.scenario.experiment import Displace
from cophy.scenario.search import SimulatedSearch


class Marbles(SimulatedSearch):
    """Found by simulation, and otherwise unknown."""

    known_do_operations = cells = symmetries = object_size_m = sample_scene = sample_do_operation = None  # type: ignore[assignment]


class Pendulums(Scenario):
    """A scenario of another kind."""

    known_do_operations = cells = symmetries = object_size_m = search = None  # type: ignore[assignment]


@pytest.mark.parametrize("kind", [Marbles, Pendulums])
def test_oracles_refuse_a_scenario_that_they_do_not_know_in_one_line(
    kind: type[Scenario], scenario_of: Callable[..., Scenario], simulator: Simulator
) -> None:
    known = scenario_of("balls")
    scene, displaced = known.sample_scene(0, (0, 1), np.random.default_rng(0)), Displace("displace", 0, (0.1, 0.0, 0.0))
    unknown = object.__new__(kind)
    vars(unknown).update(vars(known), name="new")
    asked = {"draws": 2, "rng": np.random.default_rng(0), "simulator": simulator}
    with pytest.raises(CophyError, match=rf"^the oracles do not know scenario=new: .*{kind.__name__}[^\n]*$"):
        resample(unknown, scene, displaced, **asked)
    if kind is Pendulums:  # AB of marbles tells what the oracle with AB needs
        with pytest.raises(CophyError, match="scenario=new"):
            posterior(unknown, scene, displaced, np.zeros((30, 9, 3)), max_configurations=2, noise=0.05, **asked)
