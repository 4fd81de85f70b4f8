"""What README and docs say of choices, commands and files is so."""

import re
import shlex
from pathlib import Path
from urllib.parse import unquote

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, Override

from cophy.app.composition import settings
from tests.conftest import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SHELL_VARIABLE = re.compile(r"^ +([A-Z])=(\S+)", re.MULTILINE)
COMMAND = re.compile(r"python (src/\w+\.py[^`\n]*)")
UNFINISHED = ("…", "<", "--help", "--config-dir")  # not to be composed as it stands
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")


def commands(page: Path) -> set[tuple[str, ...]]:
    """The command lines of a page, in words, with shell variables as the page sets them."""
    text = page.read_text()
    for name, value in SHELL_VARIABLE.findall(text):
        text = text.replace(f"${name}", value)
    return {tuple(shlex.split(line, comments=True)) for line in COMMAND.findall(text)}


def first_choice(override: Override) -> str:
    """Of a sweep the first run's."""
    line = str(override.input_line)
    if not override.is_sweep_override():
        return line
    key = line.split("=")[0]
    if isinstance(override.value(), Glob):
        return f"{key}={min(path.stem for path in (ROOT / 'conf' / key).iterdir())}"
    return f"{key}={next(override.sweep_string_iterator())}"


def test_the_readme_names_every_choice() -> None:
    readme = (ROOT / "README.md").read_text()
    for group in ("scenario", "model", "ablation", "table"):
        for path in (ROOT / "conf" / group).iterdir():
            assert f"`{path.stem}`" in readme, f"{group}={path.stem}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_composes(page: Path) -> None:
    for script, *words in commands(page):
        given = [word.split("|")[0] for word in words if word != "-m"]  # `balls|collision`: either
        if not any(mark in word for word in words for mark in UNFINISHED):
            settings(Path(script).stem, *map(first_choice, OverridesParser.create().parse_overrides(given)))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_link_leads_to_a_file(page: Path) -> None:
    for target in LINK.findall(page.read_text()):
        if "://" not in target:
            assert (page.parent / unquote(target)).exists(), target
