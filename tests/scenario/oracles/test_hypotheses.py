"""The mean of what could be, and what chance adds to its error: against closed forms."""

import numpy as np
import pytest

from cophy.oracles.posterior import Hypotheses
from cophy.scenario import Trajectory


def trajectory(x: float) -> Trajectory:
    """One object, at rest."""
    states = np.zeros((1, 1, 13))
    states[..., 0] = x
    return Trajectory(states, np.ones(1, dtype=bool))


def test_what_is_enumerated_has_a_weighted_mean_and_no_variance() -> None:
    hypotheses = Hypotheses([trajectory(0.0), trajectory(4.0)], np.array([0.75, 0.25]))
    assert hypotheses.mean(hypotheses.states)[0, 0, 0] == 1.0
    assert (hypotheses.variance_of_mean(hypotheses.states) == 0).all()


def test_the_variance_of_a_mean_is_that_of_independent_draws() -> None:
    hypotheses = Hypotheses.drawn([[trajectory(x)] for x in (1.0, 2.0, 3.0)])
    assert hypotheses.mean(hypotheses.states)[0, 0, 0] == pytest.approx(2.0)
    assert hypotheses.variance_of_mean(hypotheses.states)[0, 0, 0] == pytest.approx(1.0 / 3)


@pytest.mark.parametrize("alike", [0.0, 0.9], ids=["twins are independent", "twins are alike"])
def test_the_squared_error_without_the_variance_is_that_of_the_exact_mean(alike: float) -> None:
    """D is normal with variance 1, so that the MSE of the exact mean is 1; a mean of so few draws is far from it."""
    rng, found, naive = np.random.default_rng(0), [], []
    for _ in range(4000):
        shared, own = rng.normal(size=(4, 1)), rng.normal(size=(4, 2))
        twins = np.sqrt(alike) * shared + np.sqrt(1 - alike) * own
        hypotheses = Hypotheses.drawn([[trajectory(x) for x in pair] for pair in twins.tolist()])
        error = (hypotheses.mean(hypotheses.states)[0, 0, 0] - rng.normal()) ** 2
        naive.append(error)
        found.append(error - hypotheses.variance_of_mean(hypotheses.states)[0, 0, 0])
    assert np.mean(naive) == pytest.approx(1 + (1 + alike) / 8, abs=0.07)
    assert np.mean(found) == pytest.approx(1.0, abs=0.07)
