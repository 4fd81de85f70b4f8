"""A dataset that several jobs make."""

from pathlib import Path

from cophy.dataset import generation
from cophy.dataset.states import States
from tests.commands import run, run_apart
from tests.conftest import tiny_spec


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.suffix in (".h5", ".json")}


def states(data: Path) -> States:
    return States(tiny_spec("collision"), data)


def test_parts_have_the_bytes_of_the_whole(tiny_data: Path, tmp_path: Path) -> None:
    made = states(tmp_path)
    generation.make_part(made, 1, 2, workers=1)
    assert [path.name for path in made.directory.glob("*.h5")] == ["shard-00001.h5"]
    assert not made.is_finished()
    generation.make_part(made, 0, 2, workers=1)
    assert contents(made.directory) == contents(states(tiny_data).directory)


def test_a_part_mends_its_own_shards_and_waits_for_others(tmp_path: Path) -> None:
    made = states(tmp_path)
    for part in (0, 1):
        generation.make_part(made, part, 2, workers=1)
    whole = contents(made.directory)
    (made.directory / "manifest.json").unlink()
    path = made.path(1)
    path.write_bytes(path.read_bytes()[:1000])
    generation.make_part(made, 0, 2, workers=1)
    assert not made.is_finished()  # nobody vouches for a damaged shard
    generation.make_part(made, 1, 2, workers=1)
    assert contents(made.directory) == whole


def test_jobs_side_by_side_make_one_dataset(tiny_data: Path, tmp_path: Path) -> None:
    of_both = ("scenario=collision", "size=tiny", "part=0,1", "parts=2", "workers=1", f"data_dir={tmp_path}")
    printed = run_apart("generate", "-m", *of_both, "hydra/launcher=local", "hydra.launcher.n_jobs=2")
    assert "48 experiments, 2 shards, all whole" in printed
    assert contents(states(tmp_path).directory) == contents(states(tiny_data).directory)


def test_a_part_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    printed = run("generate", "scenario=collision", "size=tiny", "part=2", "parts=2", f"data_dir={tmp_path}", code=1)
    assert "part=2 must be from 0 to parts - 1 = 1" in printed


def test_what_oracles_say_is_made_in_parts_too(tmp_path: Path) -> None:
    few = ("scenario=collision", "size=tiny", "model=oracle_feedforward", "model.draws=4", "model.max_configurations=4")
    for name, parts in (("whole", [("part=0", "parts=1")]), ("parts", [("part=0", "parts=2"), ("part=1", "parts=2")])):
        data = f"data_dir={tmp_path / name}"
        run("generate", "scenario=collision", "size=tiny", data)
        for part in parts:
            run("generate", *few, *part, data)
    whole, made = (next((tmp_path / name).rglob("oracles-*")) for name in ("whole", "parts"))
    assert len(contents(whole)) == 3
    assert contents(made) == contents(whole)
    printed = run("generate", "scenario=collision", "size=tiny", "model=cophynet", f"data_dir={tmp_path}", code=1)
    assert "model: only what an oracle says" in printed
