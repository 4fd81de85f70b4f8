"""What README and docs say of choices, commands and files is so; the README's first steps run."""

import os
import re
import shlex
from pathlib import Path
from urllib.parse import unquote

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, Override

from cophy.report.paper_tables import methods, paper_tables
from tests.commands import python
from tests.conftest import ROOT, cached_settings
from tests.test_docs import PAGES, found_on_pages

README = ROOT / "README.md"
GROUPS = {path.parent.relative_to(ROOT / "conf").as_posix() for path in (ROOT / "conf").rglob("*/*.yaml")}
SHELL_VARIABLE = re.compile(r"^ +([A-Z])=(\S+)", re.MULTILINE)
COMMAND = re.compile(r"(?:python src/|(?<![/\w])cophy-(?=\w+ ))(\w+)(?:\.py)?\b([^`\n]*)")
# not to be composed as it stands; Optuna is not installed by default, SLURM sets its variables
UNFINISHED = ("…", "<", "--help", "--config-dir", "hydra/sweeper=", "$SLURM")
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")


def commands(page: Path) -> list[tuple[str, ...]]:
    """The command lines of a page, in words, with shell variables as the page sets them."""
    text = page.read_text().replace("\\\n", " ")
    for name, value in SHELL_VARIABLE.findall(text):
        text = text.replace(f"${name}", value)
    return [(script, *shlex.split(words, comments=True)) for script, words in COMMAND.findall(text)]


def choices(override: Override) -> list[str]:
    """Return the values of an override: those of all its runs, where it is a sweep."""
    if not override.is_sweep_override():
        return [override.get_value_element_as_str()]
    if isinstance(override.value(), Glob):
        return override.value().filter([path.stem for path in (ROOT / "conf" / override.key_or_group).iterdir()])
    return list(override.sweep_string_iterator())


def run(directory: Path, *words: object) -> str:
    """A Python program in a directory, with this checkout's package; its output."""
    path = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))
    return python(*words, cwd=directory, env={"PYTHONPATH": path}).stdout


def test_the_training_guide_names_every_choice() -> None:
    page = (ROOT / "docs" / "guides" / "training.md").read_text()
    options = {table.id for table in paper_tables()}
    for group in ("scenario", "split", "size", "model", "ablation", "render", "source", "confounders"):
        options |= {path.stem for path in (ROOT / "conf" / group).glob("*.yaml")}
    assert [choice for choice in sorted(options) if f"`{choice}`" not in page] == []


def test_a_command_that_goes_on_has_its_rest_on_the_next_line() -> None:
    assert found_on_pages(lambda page: re.findall(r".*\\\n\s*\n", page.read_text())) == {}


def test_every_command_composes() -> None:
    """Every choice exists. Commands are composed, the longest first, until every key of theirs has been composed once."""
    documented = {
        (script, tuple(word.split("|")[0] for word in words if word != "-m"))  # `balls|collision`: either
        for page in PAGES
        for script, *words in commands(page)
        if not any(mark in word for word in words for mark in UNFINISHED)
    }
    known = {group: {path.stem for path in (ROOT / "conf" / group).glob("*.yaml")} for group in GROUPS}
    known |= {"row": set(methods()), "table": {table.id for table in paper_tables()}}
    composed = set()
    for script, words in sorted(documented, key=lambda command: -len(command[1])):
        overrides = OverridesParser.create().parse_overrides(list(words))
        keys = {override.get_key_element(): choices(override) for override in overrides}
        for key, values in keys.items():
            assert set(values) <= known.get(key.lstrip("+"), set(values)), f"{script} {' '.join(words)}"
        needed = {(script, key) for key in ("", *keys)}
        if not composed >= needed:
            # Hydra gives each run of a table its scenario
            tables = {table.id: next(iter(table.cells()))[2]["scenario"] for table in paper_tables()}
            of_table = {"scenario": [tables[keys["+table"][0]]]} if "+table" in keys else {}
            cached_settings(script, *(f"{key}={values[0]}" for key, values in (of_table | keys).items()))
            composed |= needed
    assert {script for script, _ in composed} == {path.stem for path in (ROOT / "src").glob("*.py")}


def test_every_link_leads_to_a_file() -> None:
    def broken(page: Path) -> list[str]:
        targets = [target for target in LINK.findall(page.read_text()) if "://" not in target]
        return [target for target in targets if not (page.parent / unquote(target)).exists()]

    assert found_on_pages(broken) == {}


@pytest.mark.slow
def test_the_first_steps_run(tiny_data: Path, tmp_path: Path) -> None:
    section = README.read_text().split("## First steps")[1].split("## ")[0]
    steps = COMMAND.findall(section.split("\n\n")[1])
    assert [script for script, _ in steps] == ["look", "train", "train", "report"]
    for script, words in steps:
        tiny = {"report": [], "look": [f"data_dir={tmp_path}"]}.get(script, ["size=tiny", f"data_dir={tiny_data}"])
        quick = {"train": ["trainer.max_epochs=1"], "look": ["render.resolution=112"]}.get(script, [])
        run(tmp_path, ROOT / "src" / f"{script}.py", *shlex.split(words, comments=True), *tiny, *quick)
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


def test_locked_packages_have_hashes_and_tools_have_versions() -> None:
    locks = [path.read_text().replace("\\\n", "").splitlines() for path in sorted(ROOT.glob("requirements*.lock"))]
    requirements = [line for lines in locks for line in lines if not line.startswith("#")]
    assert [line for line in requirements if not re.match(r"\S+==\S+ +--hash=sha256:[0-9a-f]{64}", line)] == []
    names = [line.partition("==")[0] for line in requirements]
    assert len(locks) == 3
    assert sorted(set(names)) == sorted(names)  # each package is locked once
    texts = [path.read_text() for path in (*PAGES, ROOT / ".ci" / "run")]
    assert [text for text in texts if re.search(r"rust-just(?!==\d)", text)] == []
