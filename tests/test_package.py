"""The package: what it declares agrees with itself, and its sources run on every Python that it declares."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import cophy
from cophy.dataset.spec import FORMAT_VERSION
from tests import commands
from tests.conftest import ROOT
from tests.pythons.interpreters import VERSIONS, find

PYPROJECT = (ROOT / "pyproject.toml").read_text()
(OLDEST,) = re.findall(r'^requires-python = ">=([\d.]+)"', PYPROJECT, re.MULTILINE)
DECLARED = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', PYPROJECT)
COMMANDS = re.findall(r'^(cophy-\w+) = "cophy.commands', PYPROJECT, re.MULTILINE)
COMPILE = """
import pathlib, sys
for path in pathlib.Path(sys.argv[1]).rglob("*.py"):
    compile(path.read_text(encoding="utf-8"), str(path), "exec")
sys.path.insert(0, sys.argv[1])
import cophy
assert issubclass(cophy.CophyError, Exception)
assert cophy.errors.printable("a\\x1b") == "a\\\\x1b"
"""


def test_the_version_has_the_format_of_the_data() -> None:
    """0.F.R: docs/reference/upgrading.md."""
    assert re.fullmatch(rf"0\.{FORMAT_VERSION}\.\d+", cophy.__version__)
    assert re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[0] == cophy.__version__


def test_the_citation_is_of_this_version_and_of_the_paper_in_the_readme() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == cophy.__version__
    assert f'license = "{citation["license"]}"' in PYPROJECT
    paper = citation["preferred-citation"]
    assert f'Paper = "{paper["url"]}"' in PYPROJECT
    bibtex = (ROOT / "README.md").read_text().replace("{", "").replace("}", "")
    authors = " and ".join(f"{author['family-names']}, {author['given-names']}" for author in paper["authors"])
    for value in (paper["title"], authors, paper["collection-title"], str(paper["year"])):
        assert value in bibtex


def test_checks_are_for_the_oldest_python() -> None:
    """mypy and ruff refuse names and syntax that it does not have: hashlib.file_digest was used, so nothing trained on 3.10."""
    assert (DECLARED[0], VERSIONS[0]) == (OLDEST, OLDEST)
    assert f'python_version = "{OLDEST}"' in PYPROJECT
    assert f'target-version = "py{OLDEST.replace(".", "")}"' in PYPROJECT
    assert set(DECLARED) <= set(VERSIONS)


@pytest.mark.parametrize("version", [DECLARED[0], DECLARED[-1]])
def test_the_sources_compile_and_the_package_imports_on(version: str) -> None:
    """Without any other package; `just test-pythons` does more."""
    python = find(version)
    if python is None:
        pytest.skip(f"no Python {version} on PATH or in pyenv")
    result = subprocess.run(
        [python, "-B", "-I", "-c", COMPILE, ROOT / "src"], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr


def test_the_default_training_needs_no_pybullet(
    tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Python 3.12 and later, where figures of TensorBoard ended it."""
    monkeypatch.setitem(sys.modules, "pybullet", None)
    words = ("scenario=collision", "model=in", "size=tiny", f"data_dir={tiny_data}", "trainer.max_epochs=1")
    commands.run("train", *words, f"hydra.run.dir={tmp_path}")
    assert (tmp_path / "metrics.json").exists()
    assert list(tmp_path.rglob("events.out.tfevents.*"))


def test_the_package_lists_its_commands() -> None:
    result = commands.python("-m", "cophy", cwd=ROOT / "src")
    lines = dict(line.split(maxsplit=1) for line in result.stdout.partition("\n\n")[0].splitlines())
    assert sorted(lines) == sorted(COMMANDS)
    assert not [text for text in lines.values() if "python" in text or not text[0].isupper()]


def test_the_package_declares_its_types() -> None:
    assert (Path(cophy.__file__).parent / "py.typed").exists()
