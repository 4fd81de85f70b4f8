"""Sweeps, data, preempted trainings and several processes on a real SLURM of one node: just test-cluster."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from cophy.dataset.states import States
from tests.cluster.one_node_slurm import missing, one_node_slurm
from tests.commands import run, train, without_times
from tests.conftest import ROOT, tiny_spec

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(bool(missing()), reason=f"not installed: {', '.join(missing())}"),
    pytest.mark.skipif(find_spec("submitit") is None, reason="not installed: pip install 'cophy[cluster]'"),
]
ON_SLURM = ("-m", "hydra/launcher=slurm", "hydra.launcher.mem_gb=2")
IN = ("scenario=collision", "model=in", "size=tiny")

Start = Callable[..., subprocess.Popen]


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    with one_node_slurm(tmp_path_factory.mktemp("slurm") / "root") as environment:
        yield environment


@pytest.fixture
def start(slurm: dict[str, str]) -> Start:
    """Starts a command that submits jobs, and waits for them."""

    def started(script: str, *arguments: object) -> subprocess.Popen:
        command = [sys.executable, str(ROOT / "src" / f"{script}.py"), *ON_SLURM, *map(str, arguments)]
        return subprocess.Popen(command, env=slurm, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    return started


def finished(process: subprocess.Popen, code: int = 0) -> str:
    printed, _ = process.communicate(timeout=600)
    assert process.returncode == code, printed[-3000:]
    return printed


def jobs(slurm: dict[str, str], state: str) -> list[str]:
    """Ids of the jobs in a state, array tasks apart."""
    said = subprocess.run(["squeue", "-h", "-r", "-t", state, "-o", "%i"], env=slurm, capture_output=True, text=True)
    return said.stdout.split()


def until(true: Callable[[], object]) -> None:
    for _ in range(1200):
        if true():
            return
        time.sleep(0.1)
    pytest.fail("it did not happen in two minutes")


def result(outputs: Path) -> dict:
    (path,) = outputs.rglob("metrics.json")
    return json.loads(path.read_text())


def test_a_table_is_an_array_and_all_its_rows_are_in_the_report(start: Start, tiny_data: Path, tmp_path: Path) -> None:
    table = ("+table=collision", "split=all", "+row=copy_c,copy_b,in,cophynet", "size=tiny", "trainer.max_epochs=1")
    finished(start("train", *table, f"data_dir={tiny_data}", f"source.outputs={tmp_path}"))
    assert len(list(tmp_path.rglob("metrics.json"))) == 4
    run("report", f"outputs={tmp_path}", f"data_dir={tiny_data}", f"directory={tmp_path / 'report'}")
    written = "\n".join(path.read_text() for path in (tmp_path / "report").glob("*.md"))
    assert all(row in written for row in ("Copy C", "Copy B", "IN", "CoPhyNet"))


def test_a_dataset_of_many_jobs_is_that_of_one_process(start: Start, slurm: dict[str, str], tmp_path: Path) -> None:
    keys = ("scenario=collision", "size=tiny", "size.experiments_per_shard=6", "size.num_experiments.collision.2=96")
    parts = (
        *keys,
        "parts=4",
        "part=range(0,4)",
        f"data_dir={tmp_path / 'many'}",
        f"hydra.sweep.dir={tmp_path / 'log'}",
    )
    making = start("generate", *parts)
    until(lambda: jobs(slurm, "running"))
    subprocess.run(["scancel", "--signal=KILL", "--full", jobs(slurm, "running")[0]], env=slurm, check=True)
    printed, _ = making.communicate(timeout=300)
    assert making.returncode != 0, printed
    assert not list((tmp_path / "many").rglob("manifest.json"))
    finished(start("generate", *parts))
    run("generate", *keys, f"data_dir={tmp_path / 'one'}")
    spec = tiny_spec("collision", **{"experiments_per_shard": 6, "num_experiments.collision.2": 96})
    many, one = (States(spec, tmp_path / name).directory for name in ("many", "one"))
    files = sorted(path.name for path in one.iterdir() if path.suffix in (".h5", ".json"))
    assert len(files) == 16 + 1  # shards and manifest.json
    assert all((many / name).read_bytes() == (one / name).read_bytes() for name in files)


def test_a_preempted_training_is_queued_again_and_ends_as_if_undisturbed(
    start: Start, slurm: dict[str, str], tiny_data: Path, tmp_path: Path
) -> None:
    keys = (*IN, "trainer.max_epochs=60", f"data_dir={tiny_data}")
    training, last = start("train", *keys, f"source.outputs={tmp_path / 'part'}"), 0
    for name in ("TERM", "USR2", "USR2"):  # SLURM sends both to a job that it preempts; the second queues it again
        until(lambda last=last: [p for p in tmp_path.rglob("last.ckpt") if p.stat().st_mtime_ns > last])
        last = next(tmp_path.rglob("last.ckpt")).stat().st_mtime_ns
        subprocess.run(["scancel", f"--signal={name}", *jobs(slurm, "running")], env=slurm, check=True)
        until(lambda name=name: name == "TERM" or not jobs(slurm, "running"))
        last = next(tmp_path.rglob("last.ckpt")).stat().st_mtime_ns
    finished(training)
    train(*keys[:-1], f"source.outputs={tmp_path / 'whole'}", data=tiny_data)
    part, whole = result(tmp_path / "part"), result(tmp_path / "whole")
    assert part["resumed"] == 2
    assert without_times(part) == without_times(whole)


def test_a_training_whose_time_is_out_goes_on_in_the_next_job(start: Start, tiny_data: Path, tmp_path: Path) -> None:
    keys = (*IN, "trainer.max_epochs=300", f"data_dir={tiny_data}")
    minute = ("hydra.launcher.timeout_min=1", "hydra.launcher.signal_delay_s=30")
    finished(start("train", *keys, *minute, f"source.outputs={tmp_path / 'part'}"))
    train(*keys[:-1], f"source.outputs={tmp_path / 'whole'}", data=tiny_data)
    part, whole = result(tmp_path / "part"), result(tmp_path / "whole")
    assert part["resumed"] >= 1
    assert without_times(part) == without_times(whole)


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="two tasks need two cores")
def test_two_tasks_judge_as_one_process_does(start: Start, tiny_data: Path, tmp_path: Path) -> None:
    on_two = ("trainer.devices=2", "trainer.strategy=ddp", "trainer.accelerator=cpu")
    keys = (*IN, "trainer.max_epochs=2", f"source.outputs={tmp_path}")
    finished(start("train", *keys, *on_two, "hydra.launcher.tasks_per_node=2", f"data_dir={tiny_data}"))
    two = result(tmp_path)
    assert "already trained" in train(*keys, data=tiny_data)
    one = result(tmp_path)
    assert one["num_test"] == two["num_test"]
    np.testing.assert_allclose(one["metrics"]["mse"], two["metrics"]["mse"], atol=1e-6)
