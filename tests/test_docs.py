"""README and docs are short and in plain English; every page, array and picture that they name exists."""

import re
import runpy
from collections.abc import Callable
from pathlib import Path

import pytest

from cophy.dataset.states import experiment_fields
from cophy.scenario.towers import TOWER_CELLS
from tests.conftest import ROOT, SCENARIOS, tiny_spec

DOCS = sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)
PAGES = [ROOT / "README.md", ROOT / "checkpoints" / "README.md", *DOCS]
MAX_WORDS, MAX_README_WORDS, MAX_BYTES = 15_000, 600, 250_000
FENCE = re.compile(r"^( *)(```|~~~|:::).*?^\1\2 *$", re.MULTILINE | re.DOTALL)
NAMED_PAGE = re.compile(r"\bdocs/[\w/]+\.(?:md|py|csv|png)\b")
COMMIT_HASH = re.compile(r"\b(?=[0-9a-f]*[0-9])(?=[0-9a-f]*[a-f])[0-9a-f]{7,40}\b")
NOT_ENGLISH = [
    "anew",
    "goes on",
    "is told",
    "are told",
    "foretold",
    "mended",
    "is off by",
    "but for",
    "by lot",
    "lies in",
]


def found_on_pages(find: Callable[[Path], list[str]]) -> dict[str, list[str]]:
    """Return what `find` returns for a page, by the name of the page; pages for which it returns nothing are left out."""
    found = {page.relative_to(ROOT).as_posix(): find(page) for page in PAGES}
    return {name: texts for name, texts in found.items() if texts}


def num_words(text: str) -> int:
    """Count the words of a page; tables do not count."""
    return len(re.sub(r"^ *\|.*$", "", text, flags=re.MULTILINE).split())


def test_words_of_tables_do_not_count() -> None:
    assert num_words("One two\n\n| a | b |\n|---|---|\n| 1 | 2 |\n\nthree\n") == 3


def test_the_docs_can_be_read_in_an_hour() -> None:
    """The API pages, which only list names, do not count."""
    words = {page: num_words(page.read_text()) for page in PAGES if "api" not in page.parts}
    assert sum(words.values()) <= MAX_WORDS, sorted(words.items(), key=lambda item: -item[1])[:5]
    assert words[ROOT / "README.md"] <= MAX_README_WORDS


def test_no_page_names_a_commit() -> None:
    def hashes(page: Path) -> list[str]:
        prose = re.sub(r"^ *\|.*$", "", page.read_text(), flags=re.MULTILINE)  # tables may hold checksums of files
        return COMMIT_HASH.findall(prose)

    assert found_on_pages(hashes) == {}


def test_pages_are_in_plain_english() -> None:
    def phrases(page: Path) -> list[str]:
        text = " ".join(FENCE.sub("", page.read_text()).lower().split())
        return [phrase for phrase in NOT_ENGLISH if re.search(rf"\b{phrase}\b", text)]

    assert found_on_pages(phrases) == {}


def test_every_table_has_a_header() -> None:
    """A blank line within one makes its rest a paragraph."""

    def without_header(page: Path) -> list[str]:
        blocks = re.findall(r"(?:^ *\|.*\n)+", FENCE.sub("", page.read_text()) + "\n", flags=re.MULTILINE)
        return [block.splitlines()[0] for block in blocks if not re.match(r".*\n *\|[-:| ]+\|\n", block)]

    assert found_on_pages(without_header) == {}


def test_no_line_of_prose_starts_with_a_percent_sign() -> None:
    """Sphinx takes it as a comment."""
    assert found_on_pages(lambda page: re.findall(r"^%.*", FENCE.sub("", page.read_text()), re.MULTILINE)) == {}


def test_every_page_that_the_code_names_exists() -> None:
    for folder in ("src", "conf", "benchmarks", "tests"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in (".py", ".yaml"):
                for name in NAMED_PAGE.findall(path.read_text()):
                    assert (ROOT / name).exists(), f"{path}: {name}"


def test_the_data_reference_has_every_array() -> None:
    page = (ROOT / "docs" / "guides" / "data.md").read_text()
    for name in SCENARIOS:
        for field in experiment_fields(tiny_spec(name), 1):
            assert f"| `{field}` |" in page, field


FIGURES = ROOT / "docs" / "figures"


def test_figures_are_small() -> None:
    assert [path.name for path in FIGURES.iterdir() if path.stat().st_size > MAX_BYTES] == []


@pytest.mark.slow
def test_the_figures_are_drawn(tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "data").symlink_to(tiny_data)
    monkeypatch.chdir(tmp_path)
    draw, diagrams, results = (runpy.run_path(str(FIGURES / f"draw{end}.py")) for end in ("", "_diagrams", "_results"))
    data = results["load"]("tiny", tmp_path / "data")
    drawn = [draw["figures"](), diagrams["figures"](), results["figures"](data)]
    names = {name for figures in drawn for name in figures}
    assert names <= {path.stem for path in FIGURES.glob("*.png")}
    assert any(text.get_text().startswith("Do-operation: move") for text in drawn[0]["task"].texts)
    written = {text.get_text() for text in drawn[0]["cells"].texts}
    assert {cell.name for cell in TOWER_CELLS} <= written  # each of the six cells has its pictures
    errors = [axis.get_title() for axis in drawn[2]["predictions-balls"].axes]
    assert sum(title.startswith("MSE ") for title in errors) == 6
    assert results["clip"](data["collision"], 4).startswith(b"GIF89a")


def test_the_map_from_the_paper_to_the_code_names_files_that_exist() -> None:
    rooms = "|".join(path.name for path in (ROOT / "src" / "cophy").iterdir() if path.is_dir())
    named = re.findall(rf"`((?:{rooms})/[\w/.]*|conf/\w+)`", (ROOT / "docs" / "cophy" / "deviations.md").read_text())
    assert len(named) > 5
    for name in named:
        assert ((ROOT if name.startswith("conf/") else ROOT / "src" / "cophy") / name).exists(), name
