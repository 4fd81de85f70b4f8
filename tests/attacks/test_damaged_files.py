"""Damaged or hostile files are named in one line or do no harm: no code runs, nothing intact is lost, nothing hangs."""

import json
import logging
import os
import pickle
import random
import re
import shutil
import signal
import sqlite3
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cophy.commands.report import ComposedData
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.study.answers import AnswerStore
from cophy.study.judging import read_clicks, read_participants
from cophy.study.report import draw_studies, read_answers, study_tables
from tests.attacks.conftest import DATA, DERENDERER, ESTIMATED, TRAINING, Step, copy_world
from tests.commands import ending
from tests.conftest import RunsCode, tiny_spec
from tests.study.test_report import description, write_answers

pytestmark = pytest.mark.slow

NUM_FILES, NUM_ANSWER_FILES = 24, 24
MAX_SECONDS = 90
HUGE_BYTES = 2**40
VALUES = (None, True, -1, 0, 10**400, 1e308, float("nan"), float("inf"), "", "../x", "a" * 5000, [], {}, [[]], "\x00")
TEXTS = ("", "null", "[]", "{}", "[" * 100_000, "a: &a [*a]", "<html>", "x" * 10**6, '{"shards": "x"}', "\x00\xff")


def truncate(path: Path, rng: random.Random) -> None:
    os.truncate(path, rng.randrange(max(path.stat().st_size, 1)))


def flip_bit(path: Path, rng: random.Random) -> None:
    content = bytearray(path.read_bytes() or b"\0")  # lock files are empty
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def enlarge(path: Path, rng: random.Random) -> None:
    os.truncate(path, HUGE_BYTES)  # a sparse file


def replace_by_sibling(path: Path, rng: random.Random) -> None:
    others = sorted(other for other in path.parents[1].rglob(f"*{path.suffix}") if other != path and other.is_file())
    if others:
        shutil.copyfile(rng.choice(others), path)


def replace_by_link(path: Path, rng: random.Random) -> None:
    path.unlink()
    path.symlink_to(rng.choice(["/dev/zero", "nowhere", path.name, "/etc/passwd"]))


def replace_by_pipe(path: Path, rng: random.Random) -> None:
    path.unlink()
    os.mkfifo(path)


def replace_by_text(path: Path, rng: random.Random) -> None:
    path.write_text(rng.choice(TEXTS))


def replace_by_pickle(path: Path, rng: random.Random) -> None:
    path.write_bytes(pickle.dumps(RunsCode(path.parent / "executed"), protocol=rng.randrange(6)))


def change_value(path: Path, rng: random.Random) -> None:
    """Change or delete one value of a JSON file."""
    content = json.loads(path.read_bytes())
    container, key = rng.choice(list(places(content)))
    if rng.random() < 0.5:
        container[key] = rng.choice(VALUES)
    else:
        del container[key]
    path.write_text(json.dumps(content))


def places(content: Any) -> Any:
    """Yield every container in decoded JSON with each of its keys."""
    if isinstance(content, dict | list):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            yield content, key
            yield from places(value)


FAULTS: tuple[Callable[[Path, random.Random], None], ...] = (
    *(truncate, flip_bit, enlarge, replace_by_sibling, replace_by_link, replace_by_pipe, replace_by_text),
    replace_by_pickle,
)

NEW = ("hydra.run.dir={world}/new", "logger=[]")
ONE_EPOCH = ("trainer.max_epochs=1", "reuse=false")
TREE = ("scenario=collision", "source=cophy", "source.root={world}/tree", "data_dir={world}/elsewhere")
READERS = {  # commands that read a file, by its path in the world
    r"data/.*/(images|rgb)-.*": [Step("images", "train", (*DATA, *NEW, *ONE_EPOCH, *DERENDERER, "num_images=200"))],
    r"data/.*/derendered-.*": [  # a run beside those of the world, whose de-renderer it finds
        Step("estimates", "train", (*DATA, *TRAINING, *ONE_EPOCH, *ESTIMATED[:2], "seed=1"))
    ],
    r"data/.*/oracles-.*": [Step("oracles", "train", (*DATA, *NEW, "model=oracle_feedforward"))],
    r"data/.*": [
        Step("states", "train", (*DATA, *NEW, *ONE_EPOCH, "model=in")),
        Step("audit", "audit", (*DATA, "replayed_pairs=1", "directory={world}/new")),
        Step("generate", "generate", DATA),
    ],
    r"outputs/.*\.ckpt": [
        Step("resume", "train", (*DATA, *TRAINING, "trainer.max_epochs=6")),
        Step("derender", "derender", (*DATA, "outputs={world}/outputs", "workers=1")),
    ],
    r"outputs/.*": [
        Step("report", "report", ("outputs={world}/outputs", "data_dir={world}/data", "directory={world}/new"))
    ],
    r"tree/.*": [Step("released", "train", (*TREE, *NEW, *ONE_EPOCH, "model=in"))],
}


def readers_of(name: str) -> list[Step]:
    return next((steps for pattern, steps in READERS.items() if re.fullmatch(pattern, name)), [])


def files(world: Path, *, without: str = "") -> dict[str, bytes]:
    """Return the content of every regular file by its path, except one that may be too large to read."""
    names = {str(path.relative_to(world)): path for path in sorted(world.rglob("*")) if not path.is_symlink()}
    return {name: path.read_bytes() for name, path in names.items() if path.is_file() and name != without}


@pytest.fixture
def time_limit() -> Any:
    def end(signum: int, frame: Any) -> None:
        raise TimeoutError(f"more than {MAX_SECONDS} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(MAX_SECONDS)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("seed", range(NUM_FILES))
def test_a_damaged_file_is_named_or_does_no_harm(
    seed: int, worlds: list[Path], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    rng, world = random.Random(seed), copy_world(worlds[-1], tmp_path / "world")
    request.getfixturevalue("time_limit")
    names = [name for name in files(world) if readers_of(name)]
    kind = rng.choice(list(READERS))
    name = rng.choice([name for name in names if next(filter(lambda p: re.fullmatch(p, name), READERS)) == kind])
    path, reader = world / name, rng.choice(readers_of(name))
    fault = rng.choice((*FAULTS, *[change_value] * 3) if path.suffix == ".json" else FAULTS)
    fault(path, rng)
    before = files(world, without=name)
    code, text = ending(*reader.command(world))
    context = f"{fault.__name__} {name}, read by {reader.name}: {text[-2000:]}"
    assert code in (0, 1), context
    assert "Traceback" not in text, context
    assert code == 0 or path.name in text or path.parent.name in text, context
    assert not list(world.rglob("executed")), context
    after = files(world, without=name)
    changed = [name for name in before if after.get(name) != before[name] and not may_change(name, reader)]
    assert not changed, f"{changed} {context}"


def may_change(name: str, reader: Step) -> bool:
    """Return whether the reader may rewrite a file: cards, and the run that it resumes."""
    is_of_run = reader.name == "resume" and "/cophynet/" in name
    return Path(name).name in {".lock", "README.md"} or is_of_run


@pytest.fixture(scope="module")
def answers(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two answer files."""
    directory = tmp_path_factory.mktemp("answers")
    for name in ("x", "y"):
        path = directory / "study" / name / "answers.sqlite"
        write_answers(directory, description(States(tiny_spec("blocktower"), tiny_data).id), name=name)
        with sqlite3.connect(path) as db:
            db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        db.close()
    return directory


def test_damaged_answer_files_are_named_or_do_no_harm(
    answers: Path, tiny_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    uses: tuple[Callable[[Path], object], ...] = (
        lambda path: read_participants(path, "0"),
        lambda path: read_clicks(path, "0"),
        lambda path: AnswerStore(path).close(),
    )
    for seed in range(NUM_ANSWER_FILES):
        rng, world = random.Random(seed), copy_world(answers, tmp_path / "world")
        path = world / "study" / "x" / "answers.sqlite"
        rng.choice([flip_bit, *FAULTS])(path, rng)
        caplog.clear()
        with warnings.catch_warnings(), caplog.at_level(logging.INFO):
            warnings.simplefilter("ignore")  # about values that are wrong
            studies = read_answers(world, ComposedData("generated", tiny_data).dataset)
            study_tables(studies)
            draw_studies(studies)
        assert len(studies) + " ".join(caplog.text.split()).count("left out") >= 1
        before = path.read_bytes() if path.is_file() and path.stat().st_size < HUGE_BYTES else None
        for use in uses if path.exists() else ():
            if message := refusal(use, path):
                assert str(path) in message
                assert "\n" not in message
                assert before is None or path.read_bytes() == before
        assert not list(world.rglob("executed"))


def refusal(use: Callable[[Path], object], path: Path) -> str:
    """Return the message with which a file is refused, empty if it is not."""
    try:
        use(path)
    except CophyError as error:
        return str(error)
    return ""
