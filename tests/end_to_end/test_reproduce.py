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
    monkeypatch.setattr(reproduce, "OUTPUTS", tmp_path)
    jobs = [reproduce.run_job("collision", "all", row, "small", 0, 1) for row in ("copy_c", "in", "npe", "copy_b")]
    kept = tmp_path / "results.csv"
    kept.write_text(
        "scenario,split,model,ablation,size,variant,seed,training_seconds,optimizer\n"
        "collision,all,copy_c,full,small,+data_seed-1,0,0,\n"
        "collision,all,in,full,small,+data_seed-1,0,9.5,SOAP\n"
        "collision,all,npe,full,small,+data_seed-1,0,9.5,\n"  # from before the optimiser was chosen
    )
    ran: list[str] = []
    monkeypatch.setattr(reproduce, "RESULTS", kept)
    monkeypatch.setattr(reproduce, "PARTS", {"rows": lambda size: jobs})
    monkeypatch.setattr(reproduce, "run_all", lambda left, workers: ran.extend(job.name for job in left) or [])
    reproduce.main(["rows"], [], "small", 1, plan=False)
    assert ran == [job.name for job in jobs[2:]]
