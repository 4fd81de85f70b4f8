"""Figures of what was run."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from cophy.config import settings
from cophy.report import figures
from cophy.report.figures import draw_bars, of_predictions, write_figure
from cophy.report.tables import fill, paper_tables
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


def test_curves_are_of_the_largest_size_and_the_longest_training(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = {"small": 1.0, "short": 0.2, "long": 0.0, "oracle": 0.5}
    runs = pd.DataFrame([
        measured("mse", 1.0, "cophynet", directory="small", num_train=70),
        measured("mse", 0.2, "cophynet", directory="short", size="paper", num_train=700),
        measured("mse", 0.0, "cophynet", directory="long", size="paper", num_train=700, epochs=120),
        measured("mse", 0.5, "oracle_feedforward", directory="oracle", size="paper", num_train=700, num_test=100),
    ])  # fmt: skip

    def predictions(directory: str) -> dict[str, np.ndarray]:
        target, present = np.zeros((2, 3, 4, 3)), np.ones((2, 4), dtype=bool)
        position = target + np.sqrt(errors[directory])
        return {
            "initial": target[:, 0],
            "position": position,
            "target": target,
            "presence": present,
            "pair": np.arange(2),
        }

    curves: dict[str, np.ndarray] = {}
    monkeypatch.setattr(figures, "read_predictions", predictions)
    monkeypatch.setattr(figures, "draw_error_over_time", lambda found, **options: curves.update(found) or Figure())
    drawn = [name for name, _ in of_predictions(runs, {"blocktower": settings("train").scenario})]
    assert drawn[-1] == "error_over_time-blocktower-3to3"
    assert list(curves) == ["cophynet", "oracle_feedforward (first 100)"]
    assert [curve.max() for curve in curves.values()] == pytest.approx([0.0, np.sqrt(1.5)])  # of three coordinates
