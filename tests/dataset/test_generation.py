"""Resume, repair, and the same bytes however a dataset is generated."""

import errno
import hashlib
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from cophy.dataset import generation
from cophy.dataset.shardset import MANIFEST, DamagedShardError
from cophy.dataset.states import States, decode, encode
from cophy.errors import CophyError
from tests.conftest import ROOT, SCENARIOS, tiny_spec

SPEC = tiny_spec("collision")


def generate(data_dir: Path, workers: int = 2) -> Path:
    states = States(SPEC, data_dir)
    generation.make(states, workers=workers)
    return states.directory


def digests(directory: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in directory.glob("*.[hj]*")}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(tmp_path_factory.mktemp("one"), workers=1)


def copy(finished: Path, data_dir: Path) -> Path:
    directory = SPEC.directory(data_dir)
    directory.mkdir(parents=True)
    for path in finished.glob("*.[hj]*"):
        (directory / path.name).write_bytes(path.read_bytes())
    return directory


def test_one_and_two_workers_write_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    assert digests(generate(tmp_path, workers=2)) == digests(finished)


def test_generating_again_changes_nothing(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    before = {path: path.stat().st_mtime_ns for path in directory.iterdir()}
    generate(tmp_path, workers=2)
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_a_killed_generation_continues_to_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    command = [
        sys.executable,
        str(ROOT / "src" / "generate.py"),
        "scenario=collision",
        "size=tiny",
        f"data_dir={tmp_path}",
    ]
    process = subprocess.Popen([*command, "workers=1"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    directory = SPEC.directory(tmp_path)
    while not States(SPEC, tmp_path).path(0).exists():
        assert process.poll() is None, "generation ended before it could be killed"
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (directory / MANIFEST).exists()
    generate(tmp_path, workers=2)
    assert digests(directory) == digests(finished)
    assert not list(directory.glob("*.tmp"))


def test_a_truncated_shard_is_named_with_its_remedy_and_made_again(
    finished: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    directory = copy(finished, tmp_path)
    path = States(SPEC, tmp_path).path(1)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(
        CophyError, match=r"shard-00001\.h5 is damaged .* run `python src/generate\.py scenario=collision"
    ):
        States(SPEC, tmp_path).load()
    generate(tmp_path, workers=1)
    assert "shard-00001.h5 is damaged" in caplog.text
    assert digests(directory) == digests(finished)


def test_a_damaged_manifest_is_named_with_its_remedy(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).write_text("{")
    with pytest.raises(CophyError, match=r"manifest\.json is damaged .* delete it and run"):
        States(SPEC, tmp_path).load()


def test_an_unfinished_dataset_is_not_loaded(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match="is not finished: run"):
        States(SPEC, tmp_path).load()


@pytest.mark.parametrize("fault", ["missing", "external", "soft link", "shape"])
def test_a_foreign_shard_reads_nothing_but_plain_arrays(finished: Path, tmp_path: Path, fault: str) -> None:
    import h5py

    content = (finished / "shard-00000.h5").read_bytes()
    path = tmp_path / "shard.h5"
    path.write_bytes(content)
    with h5py.File(path, "r+") as file:
        del file["mass"]
        if fault == "external":
            file["mass"] = h5py.ExternalLink("/etc/passwd", "x")
        elif fault == "soft link":
            file["mass"] = h5py.SoftLink("/friction")
        elif fault == "shape":
            file.create_dataset("mass", shape=(10**9, 4), dtype="f4", chunks=(1000, 4))
    with pytest.raises(DamagedShardError, match="mass"):
        decode(path.read_bytes(), 0, SPEC)


@pytest.mark.parametrize(
    ("name", "value"),
    [("do_slot", 99), ("stratum", 9), ("shape", 7), ("split", 3), ("configuration", -1), ("twin", 10**6)],
)
def test_an_index_out_of_range_is_damage(finished: Path, name: str, value: int) -> None:
    arrays = decode((finished / "shard-00000.h5").read_bytes(), 0, SPEC)
    arrays[name][-1] = value
    with pytest.raises(DamagedShardError, match=f"'{name}' holds {value}, expected 0 to"):
        decode(encode(arrays), 0, SPEC)


@pytest.mark.parametrize(
    ("name", "value", "said"), [("object_index", -1, "does not count"), ("shape", 0, "other slots")]
)
def test_an_object_that_is_only_half_there_is_damage(finished: Path, name: str, value: int, said: str) -> None:
    arrays = decode((finished / "shard-00000.h5").read_bytes(), 0, SPEC)
    arrays[name][-1] = value
    with pytest.raises(DamagedShardError, match=f"'{name}' .*{said}"):
        decode(encode(arrays), 0, SPEC)


def test_decoding_returns_what_was_encoded(finished: Path) -> None:
    content = (finished / "shard-00000.h5").read_bytes()
    assert encode(decode(content, 0, SPEC)) == content


def test_a_full_disk_is_said_in_one_line_and_loses_nothing(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*args: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()
    monkeypatch.setattr(States, "write_manifest", full)
    with pytest.raises(CophyError, match=r"no space left .*2 of 2 shards are done.*same command again"):
        generate(tmp_path, workers=1)


def test_a_changed_constant_is_another_dataset() -> None:
    assert tiny_spec("collision").id == SPEC.id
    changed = tiny_spec("collision")
    changed.scenario.min_difference += 0.01
    assert changed.id != SPEC.id
    judged_otherwise = tiny_spec("collision")
    judged_otherwise.scenario.task.stable_speed += 0.01
    assert judged_otherwise.id == SPEC.id


def test_the_card_says_how_to_load_a_dataset(tiny_data: Path) -> None:
    """Its five lines of Python do what they say."""
    for name in SCENARIOS:
        directory = tiny_spec(name).directory(tiny_data)
        card = (directory / "README.md").read_text()
        found: dict = {}
        code = textwrap.dedent(card[card.index("    import h5py") : card.index("Audit:")])
        exec(code.replace("shard-00000.h5", str(directory / "shard-00000.h5")), found)
        assert found["states"].shape[:2] == (20, 2)
        assert found["present"].shape == found["states"].shape[:2] + found["mass"].shape[1:]
