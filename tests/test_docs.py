"""README and docs can be read: short lines and sentences; every page, array and picture that they name exists."""

import re
import runpy
from pathlib import Path

import pytest

from cophy.dataset.states import experiment_fields
from tests.conftest import ROOT, SCENARIOS, tiny_spec

PAGES = [ROOT / "README.md", *sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)]
MAX_LINE, MAX_WORDS, MAX_BYTES = 120, 30, 250_000
FENCE = re.compile(r"^( *)(```|~~~|:::).*?^\1\2 *$", re.MULTILINE | re.DOTALL)
NAMED_PAGE = re.compile(r"\bdocs/[\w/]+\.(?:md|py|csv|png)\b")


def pages(function: object) -> object:
    return pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())(function)  # type: ignore[arg-type]


def sentences(text: str) -> list[str]:
    """Of prose, list items and cells of tables; code and intervals in brackets are left out."""
    text = FENCE.sub("\n\n", text)
    text = re.sub(r"^ {4,}(?![-*\d]).*$", "", text, flags=re.MULTILINE)  # commands; list items wrap by two
    text = re.sub(r"`[^`]*`", "code", text)
    text = re.sub(r"!?\[([^\[\]]*)\]\([^)]*\)", r"\1", text)  # links and pictures are their text
    text = re.sub(r"\[[^\]]*\d[^\]]*\]", "", text)
    blocks = re.split(r"\n\s*\n|\n(?=\s*(?:[-*|#>]|\d+\.)\s?)|\|", text)
    return [sentence for block in blocks for sentence in re.split(r"(?<=[.!?])[\")*_]*\s+", " ".join(block.split()))]


def num_words(sentence: str) -> int:
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def test_sentences_are_found() -> None:
    text = "One two. Three `four five`\nsix [7, 8].\n\n- A [link](to.md).\n\n    no sentence here\n\n| a b | c |\n|---|---|\n"
    assert [num_words(each) for each in sentences(text) if num_words(each)] == [2, 3, 2, 2, 1]


@pages
def test_no_sentence_is_long(page: Path) -> None:
    assert [each for each in sentences(page.read_text()) if num_words(each) > MAX_WORDS] == []


@pages
def test_no_line_is_long(page: Path) -> None:
    """But for rows of tables, which Markdown cannot break."""
    lines = page.read_text().splitlines()
    assert [line for line in lines if len(line) > MAX_LINE and not line.lstrip().startswith("|")] == []


@pages
def test_every_table_has_a_header(page: Path) -> None:
    """A blank line within one makes its rest a paragraph."""
    blocks = re.findall(r"(?:^ *\|.*\n)+", FENCE.sub("", page.read_text()) + "\n", flags=re.MULTILINE)
    assert [block.splitlines()[0] for block in blocks if not re.match(r".*\n *\|[-:| ]+\|\n", block)] == []


@pages
def test_no_line_of_prose_starts_with_a_percent_sign(page: Path) -> None:
    """Sphinx takes it as a comment."""
    assert re.findall(r"^%.*", FENCE.sub("", page.read_text()), flags=re.MULTILINE) == []


def test_every_page_that_the_code_names_exists() -> None:
    for folder in ("src", "conf", "benchmarks", "tests"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in (".py", ".yaml"):
                for name in NAMED_PAGE.findall(path.read_text()):
                    assert (ROOT / name).exists(), f"{path}: {name}"


def test_the_data_reference_has_every_array() -> None:
    page = (ROOT / "docs" / "data" / "index.md").read_text()
    for name in SCENARIOS:
        for field in experiment_fields(tiny_spec(name), 1):
            assert f"| `{field}` |" in page, field


FIGURES = ROOT / "docs" / "figures"


def test_figures_are_small() -> None:
    assert [path.name for path in FIGURES.iterdir() if path.stat().st_size > MAX_BYTES] == []


@pytest.mark.slow
def test_the_figures_are_drawn_from_tiny_data(tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "data").symlink_to(tiny_data)
    monkeypatch.chdir(tmp_path)
    draw, diagrams, results = (runpy.run_path(str(FIGURES / f"draw{end}.py")) for end in ("", "_diagrams", "_results"))
    data = results["load"]("tiny", tmp_path / "data")
    drawn = [draw["figures"](), diagrams["figures"](), results["figures"](data)]
    names = {name for figures in drawn for name in figures}
    assert names <= {path.stem for path in FIGURES.glob("*.png")}
    shares = [text.get_text() for text in drawn[0]["oracles"].axes[0].texts]
    assert "100 %" in shares
    errors = [axis.get_title() for axis in drawn[2]["predictions-balls"].axes]
    assert sum(title.startswith("MSE ") for title in errors) == 6
    assert results["clip"](data["collision"], 4).startswith(b"GIF89a")


@pytest.mark.parametrize("page", ["README.md", "docs/paper.md"])
def test_the_map_from_the_paper_to_the_code_names_files_that_exist(page: str) -> None:
    rooms = "|".join(path.name for path in (ROOT / "src" / "cophy").iterdir() if path.is_dir())
    named = re.findall(rf"`((?:{rooms})/[\w/.]*|conf/\w+)`", (ROOT / page).read_text())
    assert len(named) > 5
    for name in named:
        assert ((ROOT if name.startswith("conf/") else ROOT / "src" / "cophy") / name).exists(), name
