"""Filled tables as Markdown and LaTeX."""

from cophy.report.tables.filled_tables import FilledTable

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
