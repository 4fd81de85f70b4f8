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


def test_a_row_of_the_results_is_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    reproduce = importlib.import_module("reproduce")
    jobs = [reproduce.run_job("collision", "all", "copy_c", "small", seed, 1) for seed in (0, 1)]
    kept = tmp_path / "results.csv"
    kept.write_text("scenario,split,model,ablation,size,variant,seed\ncollision,all,copy_c,full,small,+data_seed-1,0\n")
    ran: list[str] = []
    monkeypatch.setattr(reproduce, "RESULTS", kept)
    monkeypatch.setattr(reproduce, "OUTPUTS", tmp_path)
    monkeypatch.setattr(reproduce, "PARTS", {"rows": lambda size: jobs})
    monkeypatch.setattr(reproduce, "run_all", lambda left, workers: ran.extend(job.name for job in left) or [])
    reproduce.main(["rows"], [], "small", 1, plan=False)
    assert ran == [jobs[1].name]
