"""The plan of all results finds what its commands leave."""

import importlib
import subprocess
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def reproduce(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("reproduce")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "options", "launcher"),
    [
        ("copy_c", {}, None),
        ("copy_c", {}, "local"),
        ("trees", {}, None),
        ("oracle_feedforward", {"changes": {"model.max_experiments": 2}}, None),
        ("in", {"changes": {"training.num_experiments": 16}}, None),
        ("derenderer", {"changes": {"num_images": 40}}, None),
    ],
)
def test_a_finished_job_is_where_the_plan_looks_for_it(
    row: str,
    options: dict[str, Any],
    launcher: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    reproduce: ModuleType,
) -> None:
    monkeypatch.chdir(tmp_path)
    job = reproduce.run_job("collision", "all", row, "tiny", 2, 1, **options)
    assert reproduce.run_all([job], 1, launcher) == []
    assert job.finished.exists()


def test_a_row_of_the_results_is_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reproduce: ModuleType
) -> None:
    monkeypatch.setattr(reproduce, "OUTPUTS", tmp_path)
    finished, again = ("copy_c", "in", "oracle_counterfactual"), ("npe", "copy_b", "oracle_feedforward")
    jobs = [reproduce.run_job("collision", "all", row, "small", 0, 1) for row in (*finished, *again)]
    kept = tmp_path / "results.csv"
    kept.write_text(
        "scenario,split,datasets,model,ablation,positions,size,variant,seed,training_seconds,optimizer\n"
        "collision,all,2-x,copy_c,full,ground_truth,small,+data_seed-1,0,0,\n"
        "collision,all,2-x,in,full,ground_truth,small,+data_seed-1,0,9.5,SOAP\n"
        "collision,all,2-x,npe,full,ground_truth,small,+data_seed-1,0,9.5,\n"  # from before the optimiser was chosen
        "collision,all,2-x,copy_b,full,derendered,small,+data_seed-1,0,0,\n"  # from other positions
        "collision,all,2-x,oracle_counterfactual,full,ground_truth,small,+data_seed-1,0,0,\n"
        "collision,all,2-x,oracle_feedforward,full,ground_truth,small,+data_seed-1,0,0,\n"  # without its errors
    )
    errors = "collision,2-x,oracle_counterfactual,7,1,2.5,0.1\ncollision,2-y,oracle_feedforward,7,1,2.5,0.1\n"
    kept.with_name("oracles.csv").write_text("scenario,test_dataset,model,experiment,cluster,truth,mse\n" + errors)
    ran: list[str] = []
    monkeypatch.setattr(reproduce, "RESULTS", kept)
    monkeypatch.setattr(reproduce, "PARTS", {"rows": lambda size: jobs})
    monkeypatch.setattr(reproduce, "run_all", lambda left, *others: ran.extend(job.name for job in left) or [])
    reproduce.main(["rows"], [], "small", 1, None, plan=False)
    assert ran == [job.name for job in jobs[len(finished) :]]


def test_rows_on_estimated_positions_use_the_trainings_on_true_ones_again(reproduce: ModuleType) -> None:
    true, tested, trained = (
        [reproduce.run_job("blocktower", split, "cophynet", "small", positions=positions) for split in ("3to3", "3to4")]
        for positions in ("ground_truth", "train_ground_truth_test_derendered", "derendered")
    )
    hours = true[0].hours
    assert hours > 0
    assert reproduce.in_hours([*true, *tested]) == f"{hours:.1f}"
    assert reproduce.in_hours([*true, *trained]) == f"{2 * hours:.1f}"
    assert len({job.finished for job in [*true, *tested, *trained]}) == 6


def test_published_weights_are_tested_on_positions_of_published_derenderers(reproduce: ModuleType) -> None:
    jobs = {(job.command[2], job.command[3], job.row[4]): job for job in reproduce.estimated_jobs("small")}

    def changed(split: str, row: str, positions: str = "train_ground_truth_test_derendered") -> set[str]:
        command = jobs[f"split={split}", f"+row={row}", positions].command
        return {key for key in command if key.startswith(("predictor=", "derenderer="))}

    derenderer = {"derenderer=checkpoints/blocktower_derenderer.ckpt"}
    assert changed("3to3", "cophynet") == derenderer | {"predictor=checkpoints/blocktower_3to3_cophynet.ckpt"}
    assert changed("3to3", "cophynet", "derendered") == derenderer
    assert changed("3to3_unseen", "cophynet") == derenderer  # there are no weights with this training
    assert changed("3to4", "cophynet") == {"predictor=checkpoints/blocktower_3to3_cophynet.ckpt"}  # it saw three blocks
    assert changed("4to2", "cophynet") == {"predictor=checkpoints/balls_4to4_cophynet.ckpt"}
    assert {job.row[-1] for job in jobs.values() if job.row[:2] == ("balls", "4to4")} == {
        "+derenderer-checkpoints_balls_derenderer.ckpt"  # the variant of the rows in results.csv
    }
    at_paper = [key for job in reproduce.estimated_jobs("paper") for key in job.command]
    assert not any(key.startswith(("predictor=", "derenderer=")) for key in at_paper)
    assert {job.scenario for job in reproduce.derenderer_jobs("paper")} == {"blocktower", "balls", "collision"}
    assert {job.scenario for job in reproduce.derenderer_jobs("small")} == {"blocktower", "balls"}


def test_the_parts_have_what_their_tables_need(reproduce: ModuleType) -> None:
    cells = set(reproduce.table_rows("small", estimated=True))
    assert ("blocktower", "3to3", "cophynet", "derendered") in cells  # Table 7
    assert ("balls", "4to6", "in", "train_ground_truth_test_derendered") in cells
    assert not any(row.startswith(("oracle", "noise_floor")) for _, _, row, _ in cells)
    estimated = {key for job in reproduce.estimated_jobs("small") for key in job.command if key.startswith("+row=")}
    assert "+row=alongside" in estimated
    assert "+row=hypotheses" not in estimated  # no de-renderer estimates yaw
    curves = [job.command for job in reproduce.curve_jobs("small")]
    assert {key for command in curves for key in command if "num_experiments" in key} == {
        "training.num_experiments=700"
    }


def test_the_plan_of_the_papers_size_leaves_out_what_the_docs_do_not_need(reproduce: ModuleType) -> None:
    def jobs(part: str, row: str) -> list[list[str]]:
        return [job.command for job in reproduce.PARTS[part]("paper") if f"+row={row}" in job.command]

    for row, seeds in (("gns", {"seed=0", "seed=1", "seed=2"}), ("hypotheses", {"seed=0"})):
        assert {key for command in jobs("headline", row) for key in command if key.startswith("seed=")} == seeds
        assert {key for command in jobs("rows", row) for key in command if key.startswith("seed=")} == {"seed=0"}
    assert {command[2] for command in jobs("rows", "cophynet_adam")} == {"split=3to3", "split=4to4", "split=all"}
    assert {"split=3to3_unseen", "split=4to6"} <= {command[2] for command in jobs("rows", "cophynet")}


def test_the_plan_counts_what_is_seen_in_training(reproduce: ModuleType) -> None:
    """† has half of the experiments and twice the epochs, a transfer half, a point of a learning curve its own number."""
    whole, unseen = (reproduce.run_job("blocktower", split, "cophynet", "small") for split in ("3to3", "3to3_unseen"))
    assert unseen.hours == pytest.approx(whole.hours)
    four, two = (reproduce.run_job("balls", split, "cophynet", "small") for split in ("4to4", "4to2"))
    assert four.training == two.training
    both, one = (reproduce.run_job("collision", split, "cophynet", "small") for split in ("all", "sphere_to_cylinder"))
    assert one.hours == pytest.approx(both.hours / 2)
    changes = {"training.num_experiments": 700}
    assert reproduce.run_job("collision", "all", "in", "small", changes=changes).hours == pytest.approx(
        reproduce.run_job("collision", "all", "in", "small").hours / 4
    )
    rows = ("alongside_canonical", "cophynet")
    at_paper, of_cophynet = (reproduce.run_job("collision", "all", row, "paper") for row in rows)
    seconds = reproduce.known_seconds()["collision", :, "full"]
    assert at_paper.hours * 3600 == pytest.approx(seconds["alongside_canonical"] * 14_000 * 20)
    assert of_cophynet.hours * 3600 == pytest.approx(seconds["cophynet"] * 14_000 * 40)


def test_a_launcher_makes_every_command_a_job_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reproduce: ModuleType
) -> None:
    commands: list[list[str]] = []
    monkeypatch.setattr(reproduce, "LOGS", tmp_path)
    monkeypatch.setattr(
        subprocess, "run", lambda command, **others: commands.append(command) or SimpleNamespace(returncode=0)
    )
    job = reproduce.run_job("collision", "all", "in", "tiny")
    assert reproduce.run_all([job], 1, "slurm") == []
    assert commands[0][2:] == ["-m", *job.command[1:], "hydra/launcher=slurm"]
