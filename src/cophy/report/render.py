"""Tables as text: one renderer for the terminal, one for Markdown and one for LaTeX."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cophy.report.runs import MISSING
from cophy.report.tables import FilledTable

SHARE = "Share of the possible gain, (oracle without AB - ours) / (oracle without AB - oracle with AB)"
LATEX = {
    "→": r"$\rightarrow$",
    "†": r"$\dagger$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "—": "--",
    "%": r"\%",
    "_": r"\_",
    "<": "$<$",
}
WIDTH_FOR_INTERVALS = 100  # columns of the terminal
MAX_LABEL, WHOLE_HEADING, GAP = 28, 12, 3  # characters


class Cell(NamedTuple):
    """Parts of a cell's text, which every medium joins in its own way.

    Attributes:
        ours: Our number, or what is in its place.
        deviation: Its standard deviation over seeds, "± …".
        interval: Its interval, "[…, …]".
        failed: How many runs failed.
        paper: The paper's number.
        best: Whether ours is printed in bold.
    """

    ours: str
    deviation: str = ""
    interval: str = ""
    failed: str = ""
    paper: str = ""
    best: bool = False

    def text(self, bold: tuple[str, str] = ("", ""), *, interval: bool = True) -> str:
        """Return our part, the best between two strings."""
        ours = f"{bold[0]}{self.ours}{bold[1]}" if self.best else self.ours
        return " ".join(part for part in (ours, self.deviation, self.interval if interval else "", self.failed) if part)

    def line(self, bold: tuple[str, str] = ("", "")) -> str:
        """Return the whole cell in one line."""
        return f"{self.text(bold)} / {self.paper}" if self.paper else self.text(bold)


def table_cells(filled: FilledTable) -> pd.DataFrame:
    """Return rows × columns of `Cell`."""
    cells = [_cell(value, filled.table.digits) for value in filled.values.to_dict("records")]
    return _wide(filled.values, cells)


def share_cells(filled: FilledTable) -> pd.DataFrame:
    """Return the shares of the possible gain in %, as rows × columns of `Cell`; empty where none is known."""
    shares = filled.shares()
    return _wide(shares, [_share_cell(value) for value in shares.to_dict("records")])


def _wide(values: pd.DataFrame, cells: list[Cell]) -> pd.DataFrame:
    rows, columns = values["row"].unique(), values["column"].unique()
    by_place = dict(zip(zip(values["row"], values["column"], strict=True), cells, strict=True))
    return pd.DataFrame({column: {row: by_place[row, column] for row in rows} for column in columns}, dtype=object)


def _cell(value: dict[Any, Any], digits: int) -> Cell:
    def number(x: float) -> str:
        return f"{round(x, digits) + 0.0:.{digits}f}"  # no -0.000

    paper = MISSING if pd.isna(value["paper"]) else number(value["paper"])
    if not value["seeds"]:
        return Cell("failed" if value["failed"] else MISSING, paper=paper)
    varies = value["seeds"] > 1 and float(number(value["sd"])) > 0  # copy baselines have no random seed
    interval = f"[{number(value['low'])}, {number(value['high'])}]"
    deviation = f"± {number(value['sd'])}" if varies else ""
    failed = f"({value['failed']} failed)" if value["failed"] else ""
    return Cell(number(value["ours"]), deviation, interval, failed, paper, value["best"])


def _share_cell(value: dict[Any, Any]) -> Cell:
    if pd.isna(value["share"]):
        return Cell(MISSING)
    known = not pd.isna(value["share_low"])
    interval = f"[{value['share_low']:.0%}, {value['share_high']:.0%}]" if known else ""
    return Cell(f"{value['share']:.0%}", interval=interval)


def caption(filled: FilledTable) -> str:
    """Return the whole caption: what the cells are, the numbers of controls that were run, and runs that are left out."""
    sentences = [filled.caption]
    if filled.controls is not None:
        for label, row in table_cells(filled.controls).iterrows():
            numbers = [f"{column} {cell.text()}" for column, cell in row.items() if cell.ours != MISSING]
            sentences += [f"{label}: {', '.join(numbers)}."] if numbers else []
    return " ".join([*sentences, filled.left_out]).strip()


def markdown(filled: FilledTable) -> str:
    """Return a section with the table, the best in bold."""
    table = table_cells(filled).map(lambda cell: cell.line(bold=("**", "**"))).to_markdown()
    shares = share_cells(filled)
    gain = f"\n{SHARE}:\n\n{shares.map(Cell.line).to_markdown()}\n" if len(shares) else ""
    return f"## {filled.table.title}\n\n{table}\n\n{caption(filled)}\n{gain}"


def latex(filled: FilledTable) -> str:
    """Return a table environment (needs booktabs), the best in bold; the caption explains the cells."""
    cells = table_cells(filled).map(lambda cell: _latex_cell(cell).line(bold=(r"\textbf{", "}")))
    cells = cells.rename(index=to_latex, columns=to_latex)
    title = to_latex(f"{filled.table.title}. {caption(filled)}")
    return str(cells.to_latex(caption=title, label=f"tab:{filled.table.id}", escape=False))


def _latex_cell(cell: Cell) -> Cell:
    return cell._replace(
        ours=to_latex(cell.ours),
        deviation=to_latex(cell.deviation),
        interval=to_latex(cell.interval),
        paper=to_latex(cell.paper),
    )


def to_latex(text: str) -> str:
    """Return a text with special characters as commands of LaTeX."""
    return "".join(LATEX.get(character, character) for character in text)


def markdown_sections(tables: dict[str, pd.DataFrame], caption: str) -> str:
    """Return tables of `Cell` or text by their titles as sections, with one caption below all."""
    sections = [f"\n## {title}\n\n{table.map(_line).to_markdown()}\n" for title, table in tables.items()]
    return "".join([*sections, f"\n{caption}\n"]) if sections else ""


def _line(cell: Cell | str) -> str:
    return cell.line() if isinstance(cell, Cell) else str(cell)


def show(title: str, cells: pd.DataFrame, caption: str = "") -> None:
    """Print a table; the paper's number is below ours. Intervals are printed where they fit.

    No word and no number is broken: columns that do not fit next to each other are printed below each other.

    Args:
        title: Printed above.
        cells: `Cell` or texts; the index is the first column.
        caption: Printed below.
    """
    console = Console(highlight=False)
    cells = cells.map(lambda cell: cell if isinstance(cell, Cell) else Cell(str(cell)))
    texts = cells.map(lambda cell: _lines(cell, interval=True))
    if console.width < WIDTH_FOR_INTERVALS or len(_blocks(texts, console.width)) > 1:
        short = cells.map(lambda cell: _lines(cell, interval=False))
        texts = min(short, short.T, key=lambda each: len(_blocks(each, console.width)))
        cells = cells if texts is short else cells.T
    console.print(title, style="bold", markup=False)
    for block in _blocks(texts, console.width):
        console.print(_rich_table(texts[block], cells[block], console.width))
    console.print(f"{caption}\n" if caption else "", markup=False)


def filled_only(cells: pd.DataFrame) -> pd.DataFrame:
    """Drop the rows and columns in which there is nothing of ours."""
    ours = cells.map(lambda cell: cell.ours != MISSING)
    return cells.loc[ours.any(axis=1), ours.any(axis=0)]


def _lines(cell: Cell, *, interval: bool) -> str:
    text = cell.text(interval=interval)
    return text if cell.paper in ("", MISSING) else f"{text}\n{cell.paper}"


def _blocks(texts: pd.DataFrame, width: int) -> list[list[str]]:
    """Return the columns that fit next to each other, at least one in each block."""
    blocks: list[list[str]] = [[]]
    used = _label_width(texts)
    for column in map(str, texts.columns):
        column_width = _width(column, texts[column]) + GAP
        if blocks[-1] and used + column_width > width:
            blocks.append([])
            used = _label_width(texts)
        blocks[-1].append(column)
        used += column_width
    return blocks


def _rich_table(texts: pd.DataFrame, cells: pd.DataFrame, width: int) -> Table:
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column("", width=min(_label_width(texts), width // 2))
    for column in texts:
        table.add_column(str(column), justify="right", width=_width(str(column), texts[column]))
    for label in texts.index:
        marked = [
            f"[bold]{cell.ours}[/bold]{escape(text.removeprefix(cell.ours))}" if cell.best else escape(text)
            for text, cell in zip(texts.loc[label], cells.loc[label], strict=True)
        ]
        table.add_row(str(label), *marked)
    return table


def _label_width(texts: pd.DataFrame) -> int:
    labels = [str(label) for label in texts.index]
    return max(min(max(map(len, labels)), MAX_LABEL), *_word_lengths(labels))


def _width(heading: str, texts: "pd.Series[str]") -> int:
    """Return the width of a column in which words of its heading and lines of its cells stay whole."""
    lines = [line for text in texts for line in text.split("\n")]
    return max(min(len(heading), WHOLE_HEADING), *_word_lengths([heading]), *map(len, lines))


def _word_lengths(texts: list[str]) -> Iterator[int]:
    yield 0
    yield from (len(word) for text in texts for word in text.split())
