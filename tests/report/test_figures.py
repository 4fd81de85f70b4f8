"""Figures of what was run."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from cophy.config import settings
from cophy.drawing.plots import write_figure
from cophy.report import figures
from cophy.report.figures import draw_bars, draw_predictions
from cophy.report.paper_tables import paper_tables
from cophy.report.predictions import StoredPredictions
from cophy.report.tables import fill
from tests.report.lines import measured, scores_of_mse

TABLE, COLLISION = (next(table for table in paper_tables() if table.id == name) for name in ("blocktower", "collision"))


def drawn(*models: str) -> Figure:
    return draw_bars(fill(TABLE, pd.DataFrame([measured("mse", 0.3, model) for model in models])))


def test_only_what_was_run_has_bars() -> None:
    for models in (("copy_c",), ("copy_c", "cophynet")):
        (axis,) = drawn(*models).axes
        assert len(axis.get_xticklabels()) == len(models)
        assert len(axis.patches) == 2 * len(models)  # ours and the paper's


def test_titles_of_panels_keep_their_words_whole() -> None:
    splits = COLLISION.columns if COLLISION.methods_in == "rows" else COLLISION.rows
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
        write_figure(tmp_path / name, drawn("copy_c"))
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "a.pdf").read_bytes()[:5] == b"%PDF-"
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    assert b"/Type3" not in (tmp_path / "a.pdf").read_bytes()  # fonts are TrueType


def test_bars_have_a_unit_and_a_legend() -> None:
    figure = drawn("copy_c", "cophynet")
    assert figure.axes[0].get_ylabel() == "MSE (m²)"
    assert [text.get_text() for text in figure.legends[0].get_texts()][:2] == ["ours", "the paper's"]


def test_curves_are_of_the_largest_size_and_the_longest_training(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = {"small": 1.0, "short": 0.2, "long": 0.0, "oracle": 0.5}
    runs = pd.DataFrame([
        measured("mse", 1.0, "cophynet", directory="small", num_train=70),
        measured("mse", 0.2, "cophynet", directory="short", size="paper", num_train=700),
        measured("mse", 0.0, "cophynet", directory="long", size="paper", num_train=700, epochs=120),
        measured("mse", 0.5, "oracle_feedforward", directory="oracle", size="paper", num_train=700, num_test=100),
    ])  # fmt: skip

    def stored(directory: str) -> StoredPredictions:
        examples = {name: np.zeros((2, 3, 4, 3)) for name in ("position", "target")}
        examples |= {"initial": np.zeros((2, 4, 3)), "presence": np.ones((2, 4), dtype=bool), "pair": np.arange(2)}
        curve = np.full(3, errors[directory])
        return StoredPredictions(scores_of_mse(np.zeros(2), np.arange(2)), curve, 0.1 * curve, examples)

    curves: dict[str, np.ndarray] = {}
    monkeypatch.setattr(figures, "draw_error_over_time", lambda by_row, **options: curves.update(by_row) or Figure())
    scenarios = {"blocktower": settings("train").scenario}
    predictions = {directory: stored(directory) for directory in errors}
    drawn = [name for name, _ in draw_predictions(runs, predictions, scenarios, all_trajectories=False)]
    assert drawn[0] == "trajectories-blocktower-3to3-cophynet"
    assert len(list(draw_predictions(runs, predictions, scenarios, all_trajectories=True))) == 3
    assert drawn[-1] == "error_over_time-blocktower-3to3"
    assert list(curves) == ["CoPhyNet", "Oracle without AB\n(first 100)"]
    assert [curve.max() for curve in curves.values()] == [0.0, 0.5]
