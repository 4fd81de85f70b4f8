"""Tables as text: one renderer for the terminal, one for Markdown and one for LaTeX."""

import os
import re
import signal
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from textwrap import wrap
from typing import Any, NamedTuple

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cophy.report.runs import MISSING
from cophy.report.tables import FilledTable

SHARE = "Share of the possible gain, (oracle without AB - ours) / (oracle without AB - oracle with AB)"
UNCERTAINTY = (
    "[ ]: 95 % bootstrap interval over clusters of test experiments; ±: standard deviation over training seeds"
)
LATEX = {
    **{character: rf"\{character}" for character in "%_&#${}"},
    **{
        "→": r"$\rightarrow$",
        "†": r"$\dagger$",
        "±": r"$\pm$",
        "×": r"$\times$",
        "÷": r"$\div$",
        "—": "--",
        "²": "$^2$",
    },
    "−": "$-$",
    **{"Σ": r"$\Sigma$", "Δ": r"$\Delta$", "λ": r"$\lambda$", "<": "$<$", ">": "$>$", "|": "$|$", "≤": r"$\leq$"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "*": "$^*$"},
}
NEGATIVE_ZERO = re.compile(r"^-(?=[0.]+%?$)")
NEGATIVE = re.compile(r"(?<![\w.)-])-(?=\.?\d)")  # the sign of a number
BREAKS = re.compile(r"(?<=[^\W\d]\.)(?=\w)|(?<=\w=)")  # where a key and its value may be broken: after a point or =
LATEX_WIDTH, LATEX_LINES = 72, 40  # characters of \small in a line of article, and lines of a table on a page
LATEX_HEAD = "% Tables of report.py for a paper; in its preamble: \\usepackage{booktabs}\n"
LATEX_DOCUMENT = r"""% Compiles by itself: pdflatex document.tex
\documentclass{article}
\usepackage{booktabs}
\extrafloats{500}
\begin{document}
\input{tables}
\IfFileExists{comparisons.tex}{\input{comparisons}}{}
\end{document}
"""
WIDTH_FOR_INTERVALS = 100  # columns of the terminal
MAX_LABEL, MAX_LATEX_LABEL, WHOLE_HEADING, GAP = 28, 44, 12, 3  # characters


FAILED = "failed"  # in place of a number, where all runs failed


class Cell(NamedTuple):
    """Parts of a cell's text, which every medium joins in its own way.

    Attributes:
        ours: Our number, or what is in its place.
        deviation: Its standard deviation over seeds, "± …".
        interval: Its interval, "[…, …]".
        note: How many runs failed, or of how many experiments it is.
        paper: The paper's number.
        best: Whether ours is printed in bold.
    """

    ours: str
    deviation: str = ""
    interval: str = ""
    note: str = ""
    paper: str = ""
    best: bool = False

    def text(self, bold: tuple[str, str] = ("", ""), *, interval: bool = True) -> str:
        """Return our part, the best between two strings."""
        ours = f"{bold[0]}{self.ours}{bold[1]}" if self.best else self.ours
        return " ".join(part for part in (ours, self.deviation, self.interval if interval else "", self.note) if part)

    def line(self, bold: tuple[str, str] = ("", "")) -> str:
        """Return the whole cell in one line."""
        return f"{self.text(bold)} / {self.paper}" if self.paper else self.text(bold)


@dataclass(frozen=True)
class TextTable:
    """A table that any medium can show.

    Attributes:
        id: Its name in files.
        title: What it shows.
        cells: Rows × columns of `Cell`.
        caption: What the cells are.
        note: The part of the caption that the terminal shows.
    """

    id: str
    title: str
    cells: pd.DataFrame
    caption: str
    note: str = ""


def number(value: float, digits: int) -> str:
    """Return a number with that many digits after the point, and no negative zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def interval(low: float, high: float, form: str, scale: float = 1.0) -> str:
    """Return an interval as text; "" if it is unknown, or has no width, as with a single cluster."""
    ends = (f"{scale * end:{form}}" for end in (low, high))
    return f"[{', '.join(NEGATIVE_ZERO.sub('', end) for end in ends)}]" if low < high else ""


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
    paper = MISSING if pd.isna(value["paper"]) else number(value["paper"], digits)
    if not value["seeds"]:
        return Cell(FAILED if value["failed"] else MISSING, paper=paper)
    ours, sd = (number(value[name], digits) for name in ("ours", "sd"))
    varies = value["seeds"] > 1 and not pd.isna(value["sd"])
    ends = interval(value["low"], value["high"], f".{digits}f")
    failed = f"({value['failed']} failed)" if value["failed"] else ""
    return Cell(ours, f"± {sd}" if varies else "", ends, failed, paper, value["best"])


def _share_cell(value: dict[Any, Any]) -> Cell:
    if pd.isna(value["share"]):
        return Cell(MISSING)
    return Cell(f"{value['share']:.0%}", interval=interval(value["share_low"], value["share_high"], ".0%"))


def caption(filled: FilledTable) -> str:
    """Return the whole caption: what the cells are, the numbers of controls that were run, and runs that are left out."""
    sentences = [filled.caption]
    if filled.controls is not None:
        for label, row in table_cells(filled.controls).iterrows():
            numbers = [f"{column} {cell.text()}" for column, cell in row.items() if cell.ours != MISSING]
            sentences += [f"{label}: {', '.join(numbers)}."] if numbers else []
    return " ".join([*sentences, filled.left_out]).strip()


def paper_text_tables(filled: FilledTable, *, whole: bool) -> list[TextTable]:
    """Return a paper's table, and that of its shares of the possible gain where some are known.

    Args:
        whole: Whether rows and columns without anything of ours are shown, too.
    """
    cells, shares = table_cells(filled), share_cells(filled)
    table = TextTable(filled.table.id, filled.table.title, cells if whole else filled_only(cells), caption(filled))
    if shares.empty:
        return [table]
    shares = shares if whole else filled_only(shares)
    return [
        table,
        TextTable(f"{table.id}-share", f"{table.title.split(':')[0]}: share of the possible gain", shares, f"{SHARE}."),
    ]


def markdown(table: TextTable) -> str:
    """Return a section with the table, the best in bold."""
    text = table.cells.map(lambda cell: cell.line(bold=("**", "**"))).to_markdown()
    return f"## {table.title}\n\n{text}\n\n{table.caption}\n"


def latex(table: TextTable, *, keep_intervals: bool = False) -> str:
    """Return table environments (of booktabs) of one page each: numbers, below them intervals, below these the paper's.

    What failed is left out.

    Args:
        keep_intervals: Whether intervals are in a long table, too, on more pages.
    """
    cells = _without_failed(table.cells)
    if cells.empty:
        return ""
    lines = cells.map(lambda cell: _lines(cell, interval=False))
    if len(cells.columns) > len(cells) and len(_latex_blocks(lines.T)) < len(_latex_blocks(lines)):
        cells, lines = cells.T, lines.T
    widths = {max_label: _latex_blocks(lines, max_label) for max_label in (MAX_LATEX_LABEL, MAX_LABEL)}
    max_label, blocks = min(widths.items(), key=lambda option: len(option[1]))
    num_lines = len(blocks) * (2 if lines.map(lambda text: "\n" in text).any(axis=None) else 1)  # per row
    with_intervals = keep_intervals or (num_lines + len(blocks)) * len(cells) <= LATEX_LINES
    if keep_intervals:  # below labels of several lines
        num_lines += len(blocks) * max(1, *(-(-len(str(label)) // max_label) for label in cells.index))
    rows = len(cells) if with_intervals and not keep_intervals else max(LATEX_LINES // num_lines, 1)
    title = table.title.replace("Table", "The paper's Table", 1)
    title, caption = f"{title[:1].upper()}{title[1:]}", table.caption
    if not with_intervals and cells.map(lambda cell: bool(cell.interval)).any(axis=None):
        caption = f"{caption} Intervals are in the CSV file."
    parts = []
    for start in range(0, len(cells), rows):
        page = cells.iloc[start : start + rows]
        text = to_latex(f"{title} (continued)." if start else f"{title}. {caption}".strip())
        tabulars = "\n\\medskip\n\n".join(_tabular(page[block], with_intervals, max_label) for block in blocks)
        head = f"\\begin{{table}}[htbp]\n\\centering\n\\small\n\\caption{{{text}}}\n\\label{{tab:{table.id}{start or ''}}}\n"
        parts.append(f"{head}\\vspace{{4pt}}\n{tabulars}\\end{{table}}\n")
    return "\n".join(parts)


def _latex_blocks(texts: pd.DataFrame, max_label: int = MAX_LABEL) -> list[list[str]]:
    """Return `_blocks` of LaTeX, where keys in labels may be broken."""
    labels = [BREAKS.sub(" ", str(label)) for label in texts.index]
    return _blocks(texts.set_axis(pd.Index(labels, name=texts.index.name)), LATEX_WIDTH, max_label)


def _without_failed(cells: pd.DataFrame) -> pd.DataFrame:
    """Drop the rows and columns that only failed runs have."""
    failed = cells.map(lambda cell: cell.ours == FAILED)
    nothing = failed | cells.map(lambda cell: cell.ours == MISSING)
    kept = cells.map(lambda cell: cell._replace(ours=MISSING) if cell.ours == FAILED else cell)
    rows, columns = (failed.any(axis=axis) & nothing.all(axis=axis) for axis in (1, 0))
    return kept.loc[~rows, ~columns]


def _tabular(cells: pd.DataFrame, with_intervals: bool, max_label: int) -> str:
    """Return a tabular environment; labels and headings that are long have several lines."""
    is_long = max(len(str(label)) for label in cells.index) > max_label
    labels = rf"p{{{max_label / LATEX_WIDTH:.2f}\linewidth}}" if is_long else "l"
    headings = " & ".join([_heading(str(cells.index.name or "")), *map(_heading, map(str, cells.columns))])
    lines = [rf"\begin{{tabular}}{{{labels}{'r' * len(cells.columns)}}}", r"\toprule", rf"{headings} \\", r"\midrule"]
    for label, row in zip(cells.index, cells.itertuples(index=False), strict=True):
        ours = [to_latex(cell._replace(best=False).text(interval=False)) for cell in row]
        ours = [
            text.replace(ours_text := to_latex(cell.ours), rf"\textbf{{{ours_text}}}", 1) if cell.best else text
            for cell, text in zip(row, ours, strict=True)
        ]
        raggedright = r"\raggedright " if is_long else ""
        small = [rf"{{\scriptsize {to_latex(cell.interval)}}}" if cell.interval else "" for cell in row]
        has_intervals = with_intervals and any(small)
        if has_intervals and is_long:  # next to the label, which may have several lines, too
            ours = [
                rf"\begin{{tabular}}[t]{{@{{}}r@{{}}}}{text} \\ {below}\end{{tabular}}" if below else text
                for text, below in zip(ours, small, strict=True)
            ]
        lines.append(_row(f"{raggedright}{to_latex(str(label))}", ours))
        if has_intervals and not is_long:
            lines.append(_row("", small))
        if any(cell.paper not in ("", MISSING) for cell in row):
            lines.append(_row(r"\quad the paper's", (to_latex(cell.paper) for cell in row)))
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _row(label: str, texts: Iterable[str]) -> str:
    label = rf"{{}}{label}" if label.startswith("[") else label  # after \\, LaTeX takes it for a length
    return rf"{' & '.join([label, *texts])} \\"


def _heading(text: str) -> str:
    if len(text) <= WHOLE_HEADING:
        return to_latex(text)
    lines = wrap(text, WHOLE_HEADING, break_long_words=False)
    return r"\shortstack[r]{" + r" \\ ".join(map(to_latex, lines)) + "}"


def to_latex(text: str) -> str:
    """Return a text with special characters as commands of LaTeX."""
    parts = BREAKS.split(NEGATIVE.sub("−", text))
    return r"\allowbreak{}".join("".join(LATEX.get(character, character) for character in part) for part in parts)


class _Console(Console):
    """A console that ends the program as commands do whose output is closed, see `cophy.cli`."""

    def on_broken_pipe(self) -> None:
        """Leave the pipe, and end with the status of such programs."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)


def show(title: str, cells: pd.DataFrame, caption: str = "") -> None:
    """Print a table; the paper's number is below ours. Intervals are printed where they fit.

    No word and no number is broken: columns that do not fit next to each other are printed below each other.

    Args:
        title: Printed above.
        cells: Rows × columns of `Cell`; the index is the first column.
        caption: Printed below.
    """
    console = _Console(highlight=False)
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


def _blocks(texts: pd.DataFrame, width: int, max_label: int = MAX_LABEL) -> list[list[str]]:
    """Return the columns that fit next to each other, at least one in each block."""
    blocks: list[list[str]] = [[]]
    used = _label_width(texts, max_label)
    for column in map(str, texts.columns):
        column_width = _width(column, texts[column]) + GAP
        if blocks[-1] and used + column_width > width:
            blocks.append([])
            used = _label_width(texts, max_label)
        blocks[-1].append(column)
        used += column_width
    return blocks


def _rich_table(texts: pd.DataFrame, cells: pd.DataFrame, width: int) -> Table:
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column(escape(str(texts.index.name or "")), width=min(_label_width(texts), width // 2))
    for column in texts:
        table.add_column(escape(str(column)), justify="right", width=_width(str(column), texts[column]))
    for label, row, of_row in zip(texts.index, texts.to_numpy(), cells.to_numpy(), strict=True):
        marked = [
            f"[bold]{escape(cell.ours)}[/bold]{escape(text.removeprefix(cell.ours))}" if cell.best else escape(text)
            for text, cell in zip(row, of_row, strict=True)
        ]
        table.add_row(escape(str(label)), *marked)
    return table


def _label_width(texts: pd.DataFrame, max_label: int = MAX_LABEL) -> int:
    labels = [str(texts.index.name or ""), *map(str, texts.index)]
    return max(min(max(map(len, labels)), max_label), *_word_lengths(labels))


def _width(heading: str, texts: "pd.Series[str]") -> int:
    """Return the width of a column in which words of its heading and lines of its cells stay whole."""
    lines = [line for text in texts for line in text.split("\n")]
    return max(min(len(heading), WHOLE_HEADING), *_word_lengths([heading]), *map(len, lines))


def _word_lengths(texts: list[str]) -> Iterator[int]:
    yield 0
    yield from (len(word) for text in texts for word in text.split())
