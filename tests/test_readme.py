"""What README and docs say of choices, commands and files is so; the README's first steps run."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, Override

from cophy.report.paper_tables import paper_tables
from tests.conftest import ROOT, cached_settings

README = ROOT / "README.md"
PAGES = [README, *sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)]
SHELL_VARIABLE = re.compile(r"^ +([A-Z])=(\S+)", re.MULTILINE)
COMMAND = re.compile(r"(?:python src/|(?<![/\w])cophy-(?=\w+ ))(\w+)(?:\.py)?\b([^`\n]*)")
UNFINISHED = ("…", "<", "--help", "--config-dir")  # not to be composed as it stands
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")
MAX_README_LINES = 90


def pages(function: object) -> object:
    return pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())(function)  # type: ignore[arg-type]


def commands(page: Path) -> list[tuple[str, ...]]:
    """The command lines of a page, in words, with shell variables as the page sets them."""
    text = page.read_text().replace("\\\n", " ")
    for name, value in SHELL_VARIABLE.findall(text):
        text = text.replace(f"${name}", value)
    return [(script, *shlex.split(words, comments=True)) for script, words in COMMAND.findall(text)]


def first_choice(override: Override) -> str:
    """Return the override of the first run of a sweep."""
    line = str(override.input_line)
    if not override.is_sweep_override():
        return line
    key = line.split("=")[0]
    if isinstance(override.value(), Glob):
        return f"{key}={min(path.stem for path in (ROOT / 'conf' / key).iterdir())}"
    return f"{key}={next(override.sweep_string_iterator())}"


def is_choice(word: str) -> bool:
    """Return whether an override chooses from a group of configurations."""
    key = word.lstrip("+").split("=")[0]
    return key in ("row", "table") or (ROOT / "conf" / key).is_dir()


def run(directory: Path, *words: str) -> str:
    """A Python program in a directory, with this checkout's package; its output."""
    path = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, *words], cwd=directory, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_readme_is_short() -> None:
    assert len(README.read_text().splitlines()) <= MAX_README_LINES


def test_the_page_of_commands_names_every_choice() -> None:
    page = (ROOT / "docs" / "commands.md").read_text()
    choices = {table.id for table in paper_tables()}
    for group in ("scenario", "split", "size", "model", "ablation", "render", "source", "confounders"):
        choices |= {path.stem for path in (ROOT / "conf" / group).glob("*.yaml")}
    assert [choice for choice in sorted(choices) if f"`{choice}`" not in page] == []


@pages
def test_a_command_that_goes_on_has_its_rest_on_the_next_line(page: Path) -> None:
    assert re.findall(r".*\\\n\s*\n", page.read_text()) == []


def test_every_command_composes() -> None:
    """Commands are composed until every key, and every choice of a group, occurs in one that composes."""

    def names(script: str, words: tuple[str, ...]) -> set[tuple[str, str]]:
        keys = [word if is_choice(word) else word.split("=")[0] for word in words]
        return {(script, key) for key in ("", *keys)}

    finished = {
        (script, tuple(word.split("|")[0] for word in words if word != "-m"))  # `balls|collision`: either
        for page in PAGES
        for script, *words in commands(page)
        if not any(mark in word for word in words for mark in UNFINISHED)
    }
    composed = set()
    for script, words in sorted(finished, key=lambda command: -len(command[1])):
        if not composed >= names(script, words):
            cached_settings(script, *map(first_choice, OverridesParser.create().parse_overrides(list(words))))
            composed |= names(script, words)
    assert {script for script, _ in composed} == {path.stem for path in (ROOT / "src").glob("*.py")}


@pages
def test_every_link_leads_to_a_file(page: Path) -> None:
    for target in LINK.findall(page.read_text()):
        if "://" not in target:
            assert (page.parent / unquote(target)).exists(), target


@pytest.mark.slow
def test_the_first_steps_run(tiny_data: Path, tmp_path: Path) -> None:
    section = README.read_text().split("## First steps")[1].split("## ")[0]
    steps = COMMAND.findall(section.split("\n\n")[1])
    assert [script for script, _ in steps] == ["look", "train", "train", "report"]
    for script, words in steps:
        tiny = [] if script == "report" else ["size=tiny", f"data_dir={tiny_data}"]
        quick = {"train": ["trainer.max_epochs=1"], "look": ["render.resolution=112"]}.get(script, [])
        run(tmp_path, str(ROOT / "src" / f"{script}.py"), *shlex.split(words, comments=True), *tiny, *quick)
    assert (tmp_path / "outputs" / "look" / "collision" / "strip.png").exists()
    assert len(list((tmp_path / "outputs").glob("collision/all/**/metrics.json"))) == 3
    assert "CoPhyNet" in (tmp_path / "outputs" / "report" / "tables.md").read_text()


@pytest.mark.slow
def test_the_readme_reads_data_from_python(tiny_data: Path, tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert 'size="tiny"' in code
    code = code.replace('size="tiny"', f'size="tiny", data_dir={str(tiny_data)!r}')
    (tmp_path / "own.py").write_text(code + "print(len(data), tuple(positions.shape), tuple(mass.shape))\n")
    assert run(tmp_path, "own.py").split("\n")[-2] == "34 (2, 120, 9, 3) (9,)"
