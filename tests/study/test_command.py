"""study.py: simulated participants, power, export, and what it says where something is missing."""

from pathlib import Path

import pandas as pd
import pytest

from cophy.study.pages.serving import alone, listening
from tests.commands import run
from tests.study.conftest import Site, take_one

SMALL = ("size=tiny", "study.resolution=64", "study.num_pairs=2", "study.num_assignments=1", "participants=3")


def study(*words: object, data: Path, directory: Path, code: int = 0) -> str:
    return run("study", *words, *SMALL, f"data_dir={data}", f"directory={directory}", code=code)


def test_simulated_participants_power_and_the_report(tiny_data: Path, tmp_path: Path) -> None:
    directory = tmp_path / "study" / "blocktower"
    printed = study("simulate", data=tiny_data, directory=directory)
    assert "noisy_oracle" in printed
    printed = study("power", data=tiny_data, directory=directory)
    assert "studies find the difference with more than 300 people" in printed  # three are too few to tell
    assert pd.read_csv(directory / "power.csv")["power"].between(0, 1).all()
    assert (directory / "power.png").read_bytes().startswith(b"\x89PNG")
    printed = run("report", f"outputs={tmp_path}", f"data_dir={tiny_data}")
    assert "simulated participants, no people" in printed
    assert "0 runs" in printed  # an outputs folder without runs is no error
    assert "Human study" in (tmp_path / "report" / "tables.md").read_text()
    assert (tmp_path / "report" / "figures" / "study-blocktower-3to3-stays-cf.png").exists()
    assert study("export", data=tiny_data, directory=directory, code=1).count("nobody took this study yet") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("power",), "is made by: study.py simulate"),
        (("export",), "nobody took this study yet"),
        (("action=dance",), "is not among serve, export, simulate, power"),
        (("simulate", "participants=1"), "participants=1 must be at least 2"),
        (("study.num_pairs=3", "study.num_assignments=2"), "must be a multiple of"),
    ],
)
def test_what_is_missing_or_wrong_is_said_in_a_line(
    words: tuple[str, ...], said: str, tiny_data: Path, tmp_path: Path
) -> None:
    changed = [word for word in SMALL if word.split("=")[0] not in {each.split("=")[0] for each in words}]
    printed = run("study", *words, *changed, f"data_dir={tiny_data}", f"directory={tmp_path}", code=1)
    assert said in printed
    assert "Traceback" not in printed


def test_keys_of_another_study_export_nothing(site: Site, tiny_data: Path, tmp_path: Path) -> None:
    """And leave what was exported."""
    taken = site.participant()
    while "code" not in (place := taken.get("/api/place").json()):
        take_one(taken)
    site.participant()  # who leaves after the first page
    assert "2 participants and their codes" in study("export", data=tiny_data, directory=tmp_path)
    people = pd.read_csv(tmp_path / "participants.csv")
    assert people["code"][0] == place["code"]
    assert people["answers"].tolist() == [2, 0]
    assert people["finished_at"].isna().tolist() == [False, True]
    before = {name: (tmp_path / name).read_bytes() for name in ("answers.csv", "participants.csv", "table.csv")}
    printed = study("export", "study.seed=1", data=tiny_data, directory=tmp_path, code=1)
    (line,) = printed.strip().splitlines()
    assert "has nobody of study" in line
    assert f"it holds 2 participants of study {site.study.sessions.study}" in line
    assert {name: (tmp_path / name).read_bytes() for name in before} == before


def test_a_port_that_is_taken_is_named_before_anything_is_drawn(tiny_data: Path, tmp_path: Path) -> None:
    with listening("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        printed = study(f"port={port}", data=tiny_data, directory=tmp_path / "study", code=1)
    assert printed.strip().endswith(f"host=127.0.0.1 port={port}: Address already in use; port={port + 1} may be free")
    assert not (tmp_path / "study").exists()


def test_one_process_alone_serves_a_file(tiny_data: Path, tmp_path: Path) -> None:
    with alone(tmp_path / "answers.sqlite"):
        printed = study("port=0", data=tiny_data, directory=tmp_path, code=1)
    assert "answers.sqlite is being served by another process" in printed
