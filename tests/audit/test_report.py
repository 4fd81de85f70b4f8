"""A whole audit, and its page."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cophy.audit.checks import Check
from cophy.audit.report import audit_generated, write_page
from tests.audit.failing import failing


@pytest.mark.slow  # tests/end_to_end/test_audit.py does the same for collisions; towers take 900 simulations per pair
def test_a_correct_dataset_passes(tiny) -> None:
    spec, arrays = tiny
    assert not failing(audit_generated(arrays, spec, replayed_pairs=1))


@pytest.mark.slow
def test_states_that_are_not_finite_fail_and_stop_no_check(tiny) -> None:
    spec, arrays = tiny
    changed = arrays["states"].copy()
    changed[0] = np.nan
    checks = list(audit_generated(arrays | {"states": changed}, spec, replayed_pairs=1))
    assert "states are finite, empty slots zero" in failing(checks)
    assert checks[-1].name.endswith("among all configurations")


def test_without_varying_confounders_of_objects_there_is_no_figure_of_outcomes(tiny, tmp_path: Path) -> None:
    spec, arrays = tiny
    fixed = {name: getattr(spec.scenario.confounders, name)[:1] for name in ("mass", "friction", "restitution")}
    scenario = replace(spec.scenario, confounders=replace(spec.scenario.confounders, **fixed))
    page = write_page([Check("a line", "a result", True)], arrays, replace(spec, scenario=scenario), tmp_path)
    assert "| ok | a line | a result |" in page.read_text()
    figures = {path.name for path in tmp_path.glob("*.png")}
    assert figures == ({"outcomes.png"} if scenario.statics is not None else set())
