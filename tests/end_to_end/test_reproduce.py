"""The plan of all results finds what its commands leave."""

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "changes"), [("copy_c", {}), ("trees", {}), ("oracle_feedforward", {"max_experiments": 2})]
)
def test_a_finished_job_is_where_the_plan_looks_for_it(
    row: str, changes: dict[str, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    monkeypatch.chdir(tmp_path)
    reproduce = importlib.import_module("reproduce")
    job = reproduce.run_job("collision", "all", row, "tiny", 2, 1, changes)
    assert reproduce.run_all([job], workers=1) == []
    assert job.finished.exists()
