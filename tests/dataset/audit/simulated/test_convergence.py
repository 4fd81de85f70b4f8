"""A solver whose steps are too long is named."""

from dataclasses import replace

import pytest

from cophy.audit.simulated import convergence
from tests.dataset.audit.failing import failing


def test_steps_that_are_too_long_are_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.name != "balls":
        pytest.skip("the others converge sooner")
    coarse = replace(spec.scenario, solver=replace(spec.scenario.solver, step_rate_hz=20))
    assert failing(convergence(arrays, replace(spec, scenario=coarse), pairs=4)) == {"twice the solver's rate moves"}
