"""The audit passes what is sound, and goes on after what is not."""

import numpy as np
import pytest

from cophy.audit.report import audit_generated
from tests.dataset.audit.failing import failing

# of towers a pair takes 900 simulations under other confounders
TOWERS_SLOW = pytest.mark.parametrize(
    "tiny", [pytest.param("blocktower", marks=pytest.mark.slow), "balls", "collision"], indirect=True
)


@TOWERS_SLOW
def test_a_sound_dataset_passes(tiny) -> None:
    spec, arrays = tiny
    assert not failing(audit_generated(arrays, spec, replayed_pairs=1))


@TOWERS_SLOW
def test_a_state_that_is_no_number_is_caught_and_stops_no_check(tiny) -> None:
    spec, arrays = tiny
    changed = arrays["states"].copy()
    changed[0] = np.nan
    checks = list(audit_generated(arrays | {"states": changed}, spec, replayed_pairs=1))
    assert "states are finite, empty slots zero" in failing(checks)
    assert checks[-1].name == "simulations per experiment"
