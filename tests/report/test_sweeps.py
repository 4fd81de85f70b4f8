"""Sweeps, from runs whose numbers are known."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from cophy.report.methods import method_cells
from cophy.report.sweeps import BEST, OTHERS, Sweep, _ticks, draw_sweep, find_sweeps, sweep_table
from tests.report.lines import measured, run


def setting(
    mse: float, validation: float, directory: Path = Path("nowhere"), seed: int = 0, **changes: str
) -> dict[str, Any]:
    variant = "".join(f"+{key}-{value}" for key, value in changes.items())
    keys = tuple((f"model.{key}", value) for key, value in changes.items())
    names = {"variant": variant, "changes": keys, "validation_mse": validation, "directory": directory, "seed": seed}
    return measured("mse", mse, "drift", **names)


def sweeps(*lines: dict[str, Any]) -> list[Sweep]:
    return list(find_sweeps(method_cells(pd.DataFrame(lines))))


def test_a_sweep_has_a_table_with_the_best_by_validation_marked() -> None:
    lines = [setting(mse, 1.0 - mse, scale=scale, width="8") for mse, scale in ((0.3, "10"), (0.1, "2"), (0.2, "0.5"))]
    lines += [setting(0.5, 0.7, seed=1, scale="10", width="8"), measured("mse", 0.9, "in")]
    (sweep,) = sweeps(*lines)
    table = sweep_table(sweep)
    assert sweep.title == "Sweep of drift (width=8), blocktower, size small, true positions, 3→3"
    assert table.cells.index.tolist() == ["0.5", "2", "10"]
    assert table.cells.index.name == "scale"
    texts = table.cells.map(lambda cell: cell.text(("**", "**"), interval=False))
    assert texts["validation MSE (m²)"].tolist() == ["0.800", "0.900", "**0.700*** ± 0.000"]
    assert texts["test MSE (m²)"].tolist() == ["0.200", "0.100", "**0.400*** ± 0.141"]


def test_the_value_of_the_unchanged_setting_is_in_its_configuration(tmp_path: Path) -> None:
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text(
        "model: {scale: 1.0}\ntraining: {lr: 0.1, optimizer: {lr: '${..lr}'}}\n"
    )
    lines = [setting(0.1, 0.1, tmp_path), setting(0.2, 0.2, scale="0.5"), setting(0.3, 0.3, scale="2")]
    (sweep,) = sweeps(*lines)
    assert sweep.settings["model.scale"].tolist() == ["0.5", "1.0", "2"]
    (sweep,) = sweeps(setting(0.1, 0.1), *lines[1:])  # whose configuration is missing
    assert sweep.settings["model.scale"].tolist() == ["0.5", "2", "default"]


def test_a_configuration_that_unfolds_without_end_tells_nothing(tmp_path: Path) -> None:
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text("model: &a {scale: 1.0, again: *a}\n")
    (sweep,) = sweeps(setting(0.1, 0.1, tmp_path), setting(0.2, 0.2, scale="0.5"), setting(0.3, 0.3, scale="2"))
    assert sweep.settings["model.scale"].tolist() == ["0.5", "2", "default"]


def test_settings_on_other_data_or_splits_are_no_sweep() -> None:
    one = setting(0.1, 0.1, scale="1")
    assert sweeps(one) == []
    assert sweeps(one, setting(0.2, 0.2, scale="1", seed=1)) == []
    assert sweeps(one, setting(0.2, 0.2, scale="2") | {"split": "3to4"}) == []
    assert sweeps(one, setting(0.2, 0.2, scale="2") | {"size": "tiny"}) == []


def test_a_figure_draws_mse_over_each_numeric_key_with_bands() -> None:
    grid = [
        setting(0.1 * float(scale) + seed, 0.2, scale=scale, width=width, kind=kind, seed=seed)
        for scale in ("1", "2", "20") for width in ("8", "16") for kind in ("a", "b") for seed in (0, 1)
    ]  # fmt: skip
    (sweep,) = sweeps(*grid)
    figure = draw_sweep(sweep)
    assert figure is not None
    scale, width = figure.axes
    assert (scale.get_xlabel(), scale.get_xscale(), scale.get_ylabel()) == ("scale", "log", "MSE (m²)")
    assert (width.get_xlabel(), width.get_xscale()) == ("width", "linear")
    lines = {str(line.get_label()): line for line in scale.lines if not str(line.get_label()).startswith("_")}
    assert [*lines] == [OTHERS, "validation, ± sd over seeds", "test, ± sd over seeds", BEST]
    assert [float(x) for x in lines["test, ± sd over seeds"].get_xdata()] == [1.0, 2.0, 20.0]
    assert [text.get_text() for text in scale.get_xticklabels()] == ["1", "2", "20"]
    assert [text.get_text() for text in width.get_xticklabels()] == ["8", "16"]
    assert np.ravel(lines[BEST].get_xdata()).tolist() == [float(sweep.settings.loc[sweep.best, "model.scale"])] * 2
    assert {OTHERS, BEST} <= {text.get_text() for text in figure.legends[0].get_texts()}
    assert len(scale.collections) == 2  # bands


def test_without_a_numeric_key_there_is_no_figure() -> None:
    (sweep,) = sweeps(setting(0.1, 0.1, kind="a"), setting(0.2, 0.2, kind="b"))
    assert draw_sweep(sweep) is None


def test_without_validation_nothing_is_marked() -> None:
    nothing = float("nan")
    (sweep,) = sweeps(setting(0.1, nothing, scale="1"), setting(0.2, nothing, scale="2"))
    table = sweep_table(sweep)
    assert "*" not in table.caption
    assert table.cells["validation MSE (m²)"].map(lambda cell: cell.ours).tolist() == ["—", "—"]


def test_ticks_are_at_values_and_leave_each_other_room() -> None:
    assert _ticks([16.0, 32.0], is_log=False) == [16.0, 32.0]
    assert _ticks([1.0, 1.1, 5.0, 9.0], is_log=False) == [1.0, 5.0, 9.0]
    assert _ticks([0.001, 0.01, 0.1], is_log=True) == [0.001, 0.01, 0.1]


def test_keys_that_only_failed_runs_change_are_in_no_latex(tmp_path: Path) -> None:
    done = [setting(0.1 + n, 0.1, scale=str(n)) for n in (1, 2)]
    failed = [run("drift", error="boom", variant="+kind-a", changes=(("model.kind", "a"),))]
    for n, line in enumerate([*done, *failed]):
        line |= {"directory": tmp_path / str(n)}
    cells = method_cells(pd.DataFrame([*done, *failed]))
    (sweep,) = find_sweeps(cells)
    assert {*sweep.keys} == {"model.scale", "model.kind"}
    (in_latex,) = find_sweeps(cells[cells["seeds"] > 0])
    assert in_latex.keys == ("model.scale",)
