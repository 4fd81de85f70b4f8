"""A file that is wrong in any way is named in one line or does no harm: nothing of it runs, nothing else is lost."""

import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import note
from hypothesis import strategies as st

from tests.attacks.faults import faults_of
from tests.attacks.often import often
from tests.attacks.world import DATA, DERENDERER, TRAINING, TREE, Step, copied
from tests.commands import ending

ANEW = ("hydra.run.dir={world}/new", "trainer.max_epochs=1", "reuse=false", "logger=[]")
# what reads a file whose path below the world matches
READERS = {
    r"data/.*/images-.*|data/.*/rgb-.*": [
        Step("pictures", "train", (*DATA, *ANEW, "model=derenderer", "render.resolution=16", *DERENDERER[:-1])),
    ],
    r"data/.*/derendered-.*": [
        Step("estimates", "train", (*DATA, *TRAINING, *ANEW[1:3], "positions=derendered", "model=in", "seed=1")),
    ],
    r"data/.*/oracles-.*": [
        Step("forecasts", "train", (*DATA, *ANEW[:1], "logger=[]", "model=oracle_feedforward")),
    ],
    r"data/.*": [
        Step("states", "train", (*DATA, *ANEW, "model=in")),
        Step("audit", "audit", (*DATA, "replayed_pairs=1", "directory={world}/new")),
        Step("generate", "generate", DATA),
    ],
    r"outputs/.*\.ckpt": [
        Step("goes on", "train", (*DATA, *TRAINING, "trainer.max_epochs=5")),
        Step("derender", "derender", (*DATA, "outputs={world}/outputs", "workers=1")),
        Step("estimated", "train", (*DATA, *TRAINING, *ANEW[1:3], "positions=derendered", "model=in", "seed=1")),
    ],
    r"outputs/.*": [
        Step("report", "report", ("outputs={world}/outputs", "data_dir={world}/data", "directory={world}/new")),
    ],
    r"tree/.*": [
        Step("released", "train", (*TREE, "data_dir={world}/elsewhere", *ANEW[:1], *ANEW[2:], "model=in")),
    ],
}  # fmt: skip


def readers_of(name: str) -> list[Step]:
    return next((steps for pattern, steps in READERS.items() if re.fullmatch(pattern, name)), [])


@contextmanager
def at_most(seconds: int) -> Iterator[None]:
    """Ends what takes longer."""

    def end(signum: int, frame: Any) -> None:
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def files(world: Path, *, but: str = "") -> dict[str, bytes]:
    """What every file holds, by path, but one that may be too large to be read."""
    found = {str(path.relative_to(world)): path for path in sorted(world.rglob("*"))}
    plain = {name: path for name, path in found.items() if path.is_file() and not path.is_symlink()}
    return {name: path.read_bytes() for name, path in plain.items() if name != but}


def may_change(each: str, reader: Step) -> bool:
    """Cards are written anew, and so is the run that goes on."""
    of_the_run = reader.name == "goes on" and "/cophynet/" in each
    return Path(each).name in {".lock", "README.md", "croissant.json"} or of_the_run


def attack(whole: Path, world: Path, draw: Any) -> None:
    copied(whole, world)
    names = [name for name in files(world) if readers_of(name)]
    folders = sorted({re.sub(r"/\d+/.*|/[^/]*$", "", name) for name in names})
    chosen = draw(st.sampled_from(folders))  # else most are of the exported tree
    name = draw(st.sampled_from([each for each in names if each.startswith(chosen)]))
    path = world / name
    fault, reader = draw(st.sampled_from(faults_of(path))), draw(st.sampled_from(readers_of(name)))
    other = fault(path, draw)
    before = files(world, but=name)
    note(f"{fault.__name__} {name}, read by {reader.name}")
    with at_most(90):
        code, said = ending(*reader.command(world))
    note(said[-2000:])
    assert code in (0, 1), code
    assert "Traceback" not in said
    if code == 1:
        wrong = [path, *([other] if other else [])]
        assert any(each.name in said or each.parent.name in said for each in wrong)
    assert not list(world.rglob("executed"))
    after = files(world, but=name)
    lost = [each for each in before if after.get(each) != before[each] and not may_change(each, reader)]
    assert not lost or fault.__name__ == "swap", lost


@pytest.mark.slow
def test_many_wrong_files_are_named_or_do_no_harm(worlds: list[Path], tmp_path: Path, attacks: int) -> None:
    often(40 * attacks, lambda draw: attack(worlds[-1], tmp_path / "world", draw))
