"""The page of an audit is written whatever varies."""

from dataclasses import replace
from pathlib import Path

from cophy.audit.checks import Check
from cophy.audit.report import write_page


def test_without_a_varying_confounder_of_objects_there_is_no_figure_of_outcomes(tiny, tmp_path: Path) -> None:
    spec, arrays = tiny
    one = {name: getattr(spec.scenario.confounders, name)[:1] for name in ("mass", "friction", "restitution")}
    scenario = replace(spec.scenario, confounders=replace(spec.scenario.confounders, **one))
    page = write_page([Check("a line", "found", True)], arrays, replace(spec, scenario=scenario), tmp_path)
    assert "| ok | a line | found |" in page.read_text()
    drawn = {path.name for path in tmp_path.glob("*.png")}
    assert drawn == ({"outcomes.png"} if scenario.statics is not None else set())
