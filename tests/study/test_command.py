"""study.py: simulated participants, power, export, and its messages about missing or wrong things."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from cophy.atomic_files import MACHINE
from cophy.study.answers import exclusive
from cophy.study.experiments import StudyExperiments
from cophy.study.server import listen
from tests.commands import run
from tests.study.conftest import Site, take_task

SMALL = ("size=tiny", "study.resolution=64", "study.num_pairs=2", "study.num_assignments=1", "participants=3")


def study(*words: object, data: Path, directory: Path, code: int = 0) -> str:
    return run("study", *SMALL, *words, f"data_dir={data}", f"directory={directory}", code=code)


@pytest.fixture(scope="module")
def simulated(experiments: StudyExperiments, tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Outputs with the answers of simulated participants."""
    outputs = tmp_path_factory.mktemp("outputs")
    directory = outputs / "study" / "blocktower"
    shutil.copytree(experiments.directory, directory)
    backup, stale = directory / "simulated.sqlite.2026-pilot", directory / "simulated.sqlite-wal"
    killed = f"simulated.sqlite.{MACHINE}-{10**9}-0123abcd.tmp"  # no process has this number
    leftovers = [directory / f"{killed}{suffix}" for suffix in ("", "-wal", "-shm")]
    for path in (backup, stale, *leftovers):
        path.write_bytes(b"of another file")
    printed = study("action=simulate", data=tiny_data, directory=directory)
    assert "noisy_oracle" in printed
    assert stale.read_bytes() == b""  # of the process that reads the new file
    assert not list(directory.glob("*.tmp*"))
    assert backup.read_bytes() == b"of another file"
    return outputs


def test_power_is_computed_from_simulated_participants(simulated: Path, tiny_data: Path) -> None:
    directory = simulated / "study" / "blocktower"
    printed = study("action=power", data=tiny_data, directory=directory)
    assert "needs more than 300 participants" in printed  # three simulated ones are too few to see an effect
    assert pd.read_csv(directory / "power.csv")["power"].between(0, 1).all()
    assert (directory / "power.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow  # test_report.py writes such a report without figures
def test_a_report_without_runs_shows_simulated_participants(simulated: Path, tiny_data: Path, tmp_path: Path) -> None:
    printed = run("report", f"outputs={simulated}", f"data_dir={tiny_data}", f"directory={tmp_path}")
    assert "0 runs" in printed
    assert "Human study" in (tmp_path / "tables.md").read_text()
    assert (tmp_path / "figures" / "study-blocktower-3to3-stays-cf.png").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("action=power",), "run study.py simulate"),
        (("action=export",), "nobody has taken this study yet"),
        (("action=dance",), "is not among serve, export, simulate, power"),
        (("action=simulate", "participants=1"), "participants=1 must be at least 2"),
        (("num_objects=[3,4]",), "a study shows experiments with one number of objects"),
    ],
)
def test_missing_or_wrong_things_are_named_in_one_line(
    words: tuple[str, ...], message: str, tiny_data: Path, tmp_path: Path
) -> None:
    (line,) = study(*words, data=tiny_data, directory=tmp_path, code=1).strip().splitlines()
    assert message in line
    assert not list(tmp_path.iterdir())


def test_export_writes_nothing_for_the_keys_of_another_study(site: Site, tiny_data: Path, tmp_path: Path) -> None:
    participant = site.participant()
    while "code" not in (place := participant.get("/api/place").json()):
        take_task(participant)
    site.participant()  # leaves after the first page
    printed = run("study", "export", *SMALL, f"data_dir={tiny_data}", f"directory={tmp_path}")
    assert "2 participants and their codes" in printed
    participants = pd.read_csv(tmp_path / "participants.csv")
    assert participants["code"][0] == place["code"]
    assert participants["answers"].tolist() == [2, 0]
    assert participants["finished_at"].isna().tolist() == [False, True]
    before = {name: (tmp_path / name).read_bytes() for name in ("answers.csv", "participants.csv", "table.csv")}
    printed = study("action=export", "study.seed=1", data=tiny_data, directory=tmp_path, code=1)
    (line,) = printed.strip().splitlines()
    assert "has no participants of study" in line
    assert f"it has 2 participants of study {site.sessions.study}" in line
    assert {name: (tmp_path / name).read_bytes() for name in before} == before


@pytest.mark.parametrize("action", ["export", "power"])
def test_export_and_power_generate_nothing(
    action: str, simulated: Path, site: Site, tiny_data: Path, tmp_path: Path
) -> None:
    """For keys of another study, nor where the data of this study are missing."""
    take_task(site.participant())  # its answers are in tmp_path
    shutil.copy(simulated / "study" / "blocktower" / "simulated.sqlite", tmp_path)
    for size, message in (("small", "has no participants of study"), ("tiny", "is not finished: run `python src/gen")):
        words = (f"size={size}", f"action={action}")
        printed = study(*words, data=tmp_path / "data", directory=tmp_path, code=1)
        (line,) = printed.strip().splitlines()
        assert message in line
    assert not (tmp_path / "data").exists()


def test_a_port_in_use_is_named_before_anything_is_drawn(tiny_data: Path, tmp_path: Path) -> None:
    with listen("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        printed = study(f"port={port}", data=tiny_data, directory=tmp_path / "study", code=1)
    assert printed.strip().endswith(f"host=127.0.0.1 port={port}: Address already in use; try port={port + 1}")
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize(("action", "name"), [("serve", "answers.sqlite"), ("simulate", "simulated.sqlite")])
def test_a_file_that_another_process_writes_is_not_touched(
    action: str, name: str, tiny_data: Path, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(b"answers of many hours")
    with exclusive(path):
        printed = study(f"action={action}", "port=0", data=tiny_data, directory=tmp_path, code=1)
    assert f"{name} is being written by another process" in printed
    assert path.read_bytes() == b"answers of many hours"
    assert {file.name for file in tmp_path.iterdir()} == {name, f"{name}.lock"}
