"""study.py: simulated participants, power, export, and what it says where something is missing."""

from pathlib import Path

import pandas as pd
import pytest

from cophy.errors import CophyError
from cophy.study.server import alone, listening
from tests.commands import run
from tests.study.conftest import Site, take_one

SMALL = ("size=tiny", "study.resolution=64", "study.num_pairs=2", "study.num_assignments=1", "participants=3")


def study(*words: object, data: Path, directory: Path, code: int = 0) -> str:
    return run("study", *words, *SMALL, f"data_dir={data}", f"directory={directory}", code=code)


def test_simulated_participants_power_and_the_report(tiny_data: Path, tmp_path: Path) -> None:
    directory = tmp_path / "study" / "blocktower"
    directory.mkdir(parents=True)
    backup, stale = directory / "simulated.sqlite.2026-pilot", directory / "simulated.sqlite-wal"
    for path in (backup, stale):
        path.write_bytes(b"of another one")
    printed = study("simulate", data=tiny_data, directory=directory)
    assert "noisy_oracle" in printed
    assert stale.read_bytes() == b""  # of who reads the new file
    assert not list(directory.glob("*.tmp*"))
    assert backup.read_bytes() == b"of another one"
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


def test_a_host_without_an_address_is_named() -> None:
    for host in ("nosuchhost.invalid", "a\0b"):
        with pytest.raises(CophyError, match=r"^host=(nosuch|a)") as raised:
            listening(host, 8000)
        assert "Unknown error" not in str(raised.value)
        assert "may be free" not in str(raised.value)


def test_a_first_page_that_is_no_text_is_named(tiny_data: Path, tmp_path: Path) -> None:
    welcome = tmp_path / "welcome.md"
    welcome.write_bytes("Grüße".encode("latin-1"))
    for action in ("serve", "simulate"):
        printed = study(action, f"welcome={welcome}", "port=0", data=tiny_data, directory=tmp_path / "study", code=1)
        (line,) = printed.strip().splitlines()
        assert f"welcome={welcome} is no text: save it as UTF-8" in line
        assert not list((tmp_path / "study").glob("*.sqlite"))


def test_what_is_refused_leaves_the_simulated_answers_that_there_are(tiny_data: Path, tmp_path: Path) -> None:
    path = tmp_path / "simulated.sqlite"
    path.write_bytes(b"of hours")
    more = [word for word in SMALL if "num_pairs" not in word]
    words = ("simulate", "study.num_pairs=1000", *more, f"data_dir={tiny_data}", f"directory={tmp_path}")
    printed = run("study", *words, code=1)
    assert "study.num_pairs=1000 asks for more" in printed
    with alone(path):
        printed = study("simulate", data=tiny_data, directory=tmp_path, code=1)
    assert "simulated.sqlite is being written by another process" in printed
    assert path.read_bytes() == b"of hours"
    assert {each.name for each in tmp_path.iterdir()} == {path.name, f"{path.name}.lock"}


@pytest.mark.parametrize("action", ["serve", "export", "power", "simulate"])
def test_a_folder_in_the_place_of_a_file_is_named(action: str, tiny_data: Path, tmp_path: Path) -> None:
    name = "answers.sqlite" if action in ("serve", "export") else "simulated.sqlite"
    (tmp_path / name).mkdir()
    printed = study(action, "port=0", data=tiny_data, directory=tmp_path, code=1)
    (line,) = printed.strip().splitlines()
    assert f"{tmp_path / name} is no file of answers, or damaged (it is no plain file)" in line


@pytest.mark.parametrize("action", ["serve", "export", "power"])
@pytest.mark.parametrize("is_cut", [False, True])
def test_a_damaged_file_of_answers_is_named(
    action: str, is_cut: bool, site: Site, tiny_data: Path, tmp_path: Path
) -> None:
    take_one(site.participant())
    site.store.close()
    path = (tmp_path / "answers.sqlite").rename(
        tmp_path / ("simulated.sqlite" if action == "power" else "answers.sqlite")
    )
    path.write_bytes(path.read_bytes()[:-4096] if is_cut else b"no database" * 1000)
    before = path.read_bytes()
    printed = study(action, "port=0", data=tiny_data, directory=tmp_path, code=1)
    (line,) = printed.strip().splitlines()
    assert f"{path} is no file of answers, or damaged (" in line
    assert path.read_bytes() == before


def test_one_process_alone_serves_a_file(tiny_data: Path, tmp_path: Path) -> None:
    with alone(tmp_path / "answers.sqlite"):
        printed = study("port=0", data=tiny_data, directory=tmp_path, code=1)
    assert "answers.sqlite is being written by another process" in printed
