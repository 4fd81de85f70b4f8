"""The tables of all runs, from runs whose numbers are known."""

from typing import Any

import pandas as pd
import pytest

from cophy.report.methods import MAX_SETTINGS, method_cells, method_tables, split_title
from cophy.report.paper_tables import method_title
from cophy.report.render import Cell, TextTable
from tests.report.lines import measured, run


def tables(*lines: dict[str, Any]) -> list[TextTable]:
    return list(method_tables(method_cells(pd.DataFrame(lines))))


def texts(table: TextTable, bold: tuple[str, str] = ("", "")) -> pd.DataFrame:
    return table.cells.map(lambda cell: cell.line(bold))


def changed(mse: float, model: str, seed: int = 0, validation: float | None = None, **changes: Any) -> dict[str, Any]:
    """A run that changes keys of its model."""
    variant = "".join(f"+{key}-{value}" for key, value in changes.items())
    keys = tuple((f"model.{key}", str(value)) for key, value in changes.items())
    return measured("mse", mse, model, seed=seed, variant=variant, changes=keys, validation_mse=validation)


def test_rows_are_methods_with_what_they_change_and_columns_are_splits() -> None:
    (table,) = tables(
        changed(0.2, "drift", initial_scale=0.5),
        changed(0.4, "drift", initial_scale=0.5, seed=1),
        measured("mse", 0.3, "cophynet", split="3to4_unseen"),
        measured("mse", 0.1, "my_model"),
        run("in", error="boom"),
    )
    assert table.title == "blocktower, size small, true positions: test MSE (m²)"
    assert list(table.cells.columns) == ["3→3", "3→4 unseen"]
    assert texts(table)["3→3"].to_dict() == {
        "IN": "failed",
        "CoPhyNet": "—",
        "drift (initial_scale=0.5)": "0.300 ± 0.141 [0.290, 0.320]",
        "my_model": "0.100 [0.090, 0.120]",
    }
    assert "2,800 training and 400 test experiments; 40 epochs; training seeds: 1 to 2." in table.caption


def test_runs_on_different_data_share_no_cell() -> None:
    lines = [
        measured("mse", 0.1, "in"),
        measured("mse", 0.2, "in", size="tiny"),
        measured("mse", 0.3, "in", data="data_seed=1", variant="+data_seed-1"),
        measured("mse", 0.4, "in", positions="derendered"),
        measured("mse", 0.5, "cophynet", dataset_ids=["3-old"]),
    ]
    found = {table.title.removesuffix(": test MSE (m²)"): texts(table) for table in tables(*lines)}
    assert list(found) == [
        "blocktower, size small, estimated positions",
        "blocktower, size small, true positions",
        "blocktower, size small, true positions, data_seed=1",
        "blocktower, size tiny, true positions",
    ]
    (_, frames) = tables(lines[0], measured("mse", 0.01, "derenderer", dataset_ids=["3-x", "4-x"]))
    assert frames.title == "blocktower, size small, true positions, single frames: test MSE (m²)"
    mixed = found["blocktower, size small, true positions"]
    assert mixed.loc["IN"].tolist() == ["—", "0.100 [0.090, 0.120]"]
    assert list(mixed.columns) == ["3→3 (data 3-old)", "3→3 (data 3-x)"]


def best_of(*lines: dict[str, Any]) -> list[str]:
    (table,) = tables(*lines)
    bold = table.cells.map(lambda cell: cell.best)
    return [label for label, row in zip(bold.index, bold.to_numpy(), strict=True) if row.any()]


def test_only_comparable_methods_are_bold() -> None:
    lines = [measured("mse", 0.5, "cophynet"), measured("mse", 0.4, "drift")]
    assert best_of(*lines) == ["drift"]
    assert best_of(lines[0]) == []
    assert best_of(*lines, measured("mse", 0.4, "npe")) == ["NPE", "drift"]  # a tie
    for more in (
        measured("mse", 0.1, "in", "gt_confounders"),
        measured("mse", 0.1, "drift", "supervised_confounders"),
        measured("mse", 0.1, "oracle_counterfactual"),
        measured("mse", 0.1, "peeking", inputs=["confounders"]),
        changed(0.1, "in", pose="True"),
        measured("mse", 0.1, "npe", num_train=70),
        measured("mse", 0.1, "npe", num_test=100),
    ):
        assert best_of(*lines, more) == ["drift"]


def test_settings_compete_by_validation_and_many_are_left_to_their_sweep() -> None:
    few = [changed(0.1, "drift", validation=0.9, scale=1), changed(0.4, "drift", validation=0.2, scale=2)]
    other = measured("mse", 0.3, "cophynet")
    assert best_of(other, *few) == ["CoPhyNet"]
    many = [changed(0.1 + n, "drift", validation=0.5 + n, scale=n) for n in range(MAX_SETTINGS + 1)]
    (table,) = tables(other, *many)
    assert list(table.cells.index) == ["CoPhyNet", "drift (scale=0)"]
    assert "best by validation" in table.caption


def test_the_best_share_is_the_greatest() -> None:
    """CoPhyNet has the lowest MSE, and drift explains most."""
    shares = [("cophynet", 0.2, 0.4), ("drift", 0.3, 0.6), ("npe", 0.5, 0.5)]
    lines = [measured("twin_difference_explained", share, name) | {"metrics.mse": mse} for name, mse, share in shares]
    bold = {table.caption.partition("Bold: ")[2].split()[0]: table.cells for table in tables(*lines)}
    best = {word: [name for name, cell in cells["3→3"].items() if cell.best] for word, cells in bold.items()}
    assert best == {"lowest": ["CoPhyNet"], "highest": ["drift"]}


def test_without_validation_the_unchanged_method_competes() -> None:
    settings = [changed(0.1, "drift", scale=1), measured("mse", 0.4, "drift"), changed(0.2, "drift", scale=2)]
    assert best_of(measured("mse", 0.3, "cophynet"), *settings) == ["CoPhyNet"]
    assert best_of(measured("mse", 0.5, "cophynet"), *settings) == ["drift"]


def test_a_note_says_which_runs_and_experiments_a_cell_lacks() -> None:
    (table,) = tables(
        measured("mse", 0.3, "cophynet"),
        run("cophynet", seed=1, error="boom"),
        measured("mse", 0.4, "npe", num_test=100),
        measured("mse", 0.4, "npe", split="3to4", num_test=100),  # as many as any method has
    )
    assert texts(table)["3→3"].to_dict() == {
        "NPE": "0.400 [0.390, 0.420] (first 100)",
        "CoPhyNet": "0.300 [0.290, 0.320] (1 failed)",
    }
    assert texts(table).loc["NPE", "3→4"] == "0.400 [0.390, 0.420]"


def test_methods_of_the_user_follow_those_of_the_paper_and_oracles_are_last() -> None:
    names = ("oracle_counterfactual", "a_model", "noise_floor_rate", "cophynet", "oracle_feedforward", "copy_c")
    (table,) = tables(*(measured("mse", 0.1, name) for name in names))
    titles = [method_title(name) for name in names]
    assert list(table.cells.index[:3]) == ["Copy C", "CoPhyNet", "a_model"]
    assert set(table.cells.index[3:]) == {titles[0], titles[2], titles[4]}


def test_captions_say_what_all_trainings_change() -> None:
    shared = (("training.learning_rate", "0.01"),)
    lines = [measured("mse", 0.1, "in", changes=shared, variant="+learning_rate-0.01")]
    lines.append(measured("mse", 0.2, "npe", changes=(*shared, ("model.radius", "2")), variant="+learning_rate-0.01+r"))
    (table,) = tables(*lines, measured("mse", 0.9, "copy_c", is_trained=False))
    assert "All trainings: training.learning_rate=0.01." in table.caption
    assert list(table.cells.index) == ["Copy C", "IN", "NPE (radius=2)"]
    (table,) = tables(*lines, measured("mse", 0.3, "cophynet"))
    assert "All trainings" not in table.caption
    assert "IN (learning_rate=0.01)" in table.cells.index


def test_what_all_trainings_change_is_in_no_label() -> None:
    epochs = {"variant": "+max_epochs-5", "changes": (("trainer.max_epochs", "5"),), "epochs": 5}
    (table,) = tables(
        measured("mse", 0.1, "in", **epochs),
        measured("mse", 0.2, "npe", **epochs),
        measured("mse", 0.9, "copy_c", is_trained=False),
    )
    assert list(table.cells.index) == ["Copy C", "IN", "NPE"]
    assert "5 epochs" in table.caption


def test_twins_have_tables_of_their_own() -> None:
    lines = [measured("twin_difference_explained", 0.4, "cophynet") | {"metrics.mse": 0.2}, measured("mse", 0.3, "in")]
    mse, explained = tables(*lines)
    assert list(mse.cells.index) == ["IN", "CoPhyNet"]
    assert texts(explained)["3→3"].to_dict() == {"CoPhyNet": "40.0 [39.0, 42.0]"}
    assert "Twins share A" in explained.caption


@pytest.mark.parametrize(
    ("names", "title"),
    [
        (("copy_c",), "Copy C"),
        (("in", "gt_confounders"), "IN with true confounders"),
        (("alongside", "mlp"), "Alongside, mlp"),
        (("drift", "full", {"model.scale": "0.5", "training.lr": "1"}), "drift (scale=0.5, lr=1)"),
        (("drift", "full", {"a.x": "1", "b.x": "2"}), "drift (a.x=1, b.x=2)"),
    ],
)
def test_methods_have_the_names_of_print(names: tuple[Any, ...], title: str) -> None:
    assert method_title(*names) == title


def test_splits_have_the_names_of_print() -> None:
    names = ["3to3", "4to4_unseen", "sphere_to_cylinder", "all", "into_tower"]
    assert [split_title(name) for name in names] == ["3→3", "4→4 unseen", "sphere→cylinder", "all", "into tower"]


def test_a_dash_is_where_nothing_was_run() -> None:
    (table,) = tables(measured("mse", 0.3, "in"), measured("mse", 0.3, "npe", split="3to4"))
    assert table.cells.loc["IN", "3→4"] == Cell("—")


def test_an_interval_has_a_width_and_a_deviation_may_be_zero() -> None:
    same = [measured("mse", 0.3, "cophynet", seed=seed) | {"low.mse": 0.3, "high.mse": 0.3} for seed in (0, 1)]
    copies = [measured("mse", 0.3, "copy_c", seed=seed, is_trained=False) for seed in (0, 1)]  # no random seed
    (table,) = tables(*same, *copies)
    assert texts(table)["3→3"].to_dict() == {"Copy C": "0.300 [0.290, 0.320]", "CoPhyNet": "0.300 ± 0.000"}
