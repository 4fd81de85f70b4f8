"""Tables on the terminal: as wide as it is, no word and no number broken; what does not fit beside goes below.

Filled tables as Markdown and LaTeX.
"""

import re
from collections.abc import Iterator

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cophy.report.tables import FilledTable

SHARE = "Share of the possible gain, (oracle without AB - ours) / (oracle without AB - oracle with AB)"
LATEX = {"→": r"$\rightarrow$", "†": r"$\dagger$", "±": r"$\pm$", "×": r"$\times$", "—": "--", "%": r"\%", "_": r"\_"}


def markdown(filled: FilledTable) -> str:
    """A section with the table, the best in bold."""
    table = filled.cells(bold=("**", "**")).to_markdown()
    shares = filled.shares()
    gain = "" if shares is None else f"\n{SHARE}:\n\n{shares.to_markdown()}\n"
    return f"## {filled.table.title}\n\n{table}\n\n{filled.caption}\n{gain}"


def latex(filled: FilledTable) -> str:
    """A table environment (needs booktabs), the best in bold; the caption says what the cells are."""
    cells = filled.cells(bold=("BOLD(", ")BOLD")).map(_to_latex)
    cells = cells.replace({r"BOLD\(": r"\\textbf{", r"\)BOLD": "}"}, regex=True)
    cells = cells.rename(index=_to_latex, columns=_to_latex)
    caption = _to_latex(f"{filled.table.title}. {filled.caption}")
    return str(cells.to_latex(caption=caption, label=f"tab:{filled.table.id}", escape=False))


def _to_latex(text: str) -> str:
    return "".join(LATEX.get(character, character) for character in text)


ROOM_FOR_INTERVALS = 100  # columns
BOLD = ("BOLD(", ")BOLD")  # around what is printed in bold
WIDEST_LABEL, WHOLE_HEADING, GAP = 28, 12, 3
INTERVAL = re.compile(r" \[[^\]]*\]")
PAPER, UNKNOWN = " / ", "—"  # between our number and the paper's; in the place of a number


def show(title: str, cells: pd.DataFrame, caption: str = "") -> None:
    """Print a table; the paper's number stands below ours. Intervals are printed where there is room for them.

    Args:
        title: Stands above it.
        cells: Texts, "ours / the paper's"; the index is the first column.
        caption: Stands below it.
    """
    console = Console(highlight=False)
    texts = cells.map(lambda text: str(text).removesuffix(PAPER + UNKNOWN).replace(PAPER, "\n"))
    short = texts.map(lambda text: INTERVAL.sub("", text))
    if console.width < ROOM_FOR_INTERVALS or len(_blocks(texts, console.width)) > 1:
        texts = min(short, short.T, key=lambda each: len(_blocks(each, console.width)))
    console.print(title, style="bold", markup=False)
    for block in _blocks(texts, console.width):
        console.print(_table(texts[block], console.width))
    console.print(f"{caption}\n" if caption else "", markup=False)


def filled_only(cells: pd.DataFrame) -> pd.DataFrame:
    """Without the rows and columns in which nothing of ours stands."""
    ours = ~cells.map(lambda text: str(text).startswith(UNKNOWN))
    return cells.loc[ours.any(axis=1), ours.any(axis=0)]


def _blocks(texts: pd.DataFrame, room: int) -> list[list[str]]:
    """Columns that fit beside each other; one at least in each block."""
    blocks: list[list[str]] = [[]]
    used = _label_width(texts)
    for column in map(str, texts.columns):
        width = _width(column, texts[column]) + GAP
        if blocks[-1] and used + width > room:
            blocks.append([])
            used = _label_width(texts)
        blocks[-1].append(column)
        used += width
    return blocks


def _table(texts: pd.DataFrame, room: int) -> Table:
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column("", width=min(_label_width(texts), room // 2))
    for column in texts:
        table.add_column(str(column), justify="right", width=_width(str(column), texts[column]))
    for label, row in texts.iterrows():
        table.add_row(str(label), *(_marked(text) for text in row))
    return table


def _label_width(texts: pd.DataFrame) -> int:
    labels = [str(label) for label in texts.index]
    return max(min(max(map(len, labels)), WIDEST_LABEL), *_words(labels))


def _width(heading: str, texts: "pd.Series[str]") -> int:
    """Of a column, so that words of its heading and lines of its cells stay whole."""
    lines = [line.replace(BOLD[0], "").replace(BOLD[1], "") for text in texts for line in text.split("\n")]
    return max(min(len(heading), WHOLE_HEADING), *_words([heading]), *map(len, lines))


def _words(texts: list[str]) -> Iterator[int]:
    yield 0
    yield from (len(word) for text in texts for word in text.split())


def _marked(text: str) -> str:
    """With rich's markup."""
    return escape(text).replace(BOLD[0], "[bold]").replace(BOLD[1], "[/bold]")
