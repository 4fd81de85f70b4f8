"""Figures of what was run."""

from itertools import pairwise
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from cophy.report.figures import draw_bars, write_figure
from cophy.report.tables.filled_tables import fill
from cophy.report.tables.paper_tables import paper_tables
from tests.report.lines import measured

TABLE, COLLISION = (next(table for table in paper_tables() if table.id == name) for name in ("blocktower", "collision"))


def drawn(*models: str) -> Figure:
    return draw_bars(fill(TABLE, pd.DataFrame([measured("mse", 0.3, model) for model in models])))


def test_only_what_was_run_has_bars() -> None:
    for models in (("copy_c",), ("copy_c", "cophynet")):
        (axis,) = drawn(*models).axes
        assert len(axis.get_xticklabels()) == len(models)
        assert len(axis.patches) == 2 * len(models)  # ours and the paper's


def test_titles_of_panels_keep_their_words_whole() -> None:
    splits = COLLISION.columns if COLLISION.methods == "rows" else COLLISION.rows
    chosen = [names["split"] for names in splits.values()]
    runs = [measured("mse", 0.3, "copy_c", scenario="collision", split=split) for split in chosen]
    figure = draw_bars(fill(COLLISION, pd.DataFrame(runs)))
    titles = [axis.get_title() for axis in figure.axes]
    assert "sphere→cylinder" in titles
    assert [title.replace("\n", " ") for title in titles] == list(splits)
    figure.draw_without_rendering()
    boxes = [axis.title.get_window_extent() for axis in figure.axes]
    assert all(left.x1 <= right.x0 for left, right in pairwise(boxes))


def test_a_figure_is_a_png_and_the_same_pdf_each_time(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_figure(tmp_path, name, drawn("copy_c"))
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "a.pdf").read_bytes()[:5] == b"%PDF-"
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
