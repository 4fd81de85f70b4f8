"""Comparisons of methods: the statistics against closed forms and by simulation, and what is printed and written."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hydra.errors import HydraException
from scipy.stats import false_discovery_control, kstest, ttest_1samp, ttest_ind
from scipy.stats import t as student_t

from cophy.bootstrap import Ratio
from cophy.cli import explain
from cophy.config import settings
from cophy.errors import CophyError
from cophy.report.comparisons import (
    _signed,
    compare_methods,
    comparison_tables,
    count_tables,
    difference,
    write_comparisons,
)
from cophy.report.runs import PLACE as FOLDERS
from cophy.scoring import Scores
from tests.report.lines import scores_of_mse
from tests.report.stored_runs import PLACE, content, leave


def scored(mse: np.ndarray, clusters: np.ndarray | None = None) -> Scores:
    return scores_of_mse(mse, np.arange(len(mse)) if clusters is None else clusters)


def test_one_seed_each_is_a_paired_t_test_over_clusters() -> None:
    rng = np.random.default_rng(0)
    ours, others = rng.exponential(size=(2, 40))
    clusters = np.arange(40) // 4
    means = (ours - others).reshape(10, 4).mean(axis=1)
    expected = ttest_1samp(means, 0.0)
    value, low, high, p = difference([scored(ours, clusters)], [scored(others, clusters)], "mse")
    assert (value, p) == pytest.approx((means.mean(), expected.pvalue))
    assert (low, high) == pytest.approx(tuple(expected.confidence_interval()))


def test_seeds_alone_are_a_welch_test() -> None:
    """Where the difference is the same in all experiments, only training seeds vary."""
    ours, others = [0.1, 0.2, 0.4, 0.3], [0.5, 0.9, 0.6]
    expected = ttest_ind(ours, others, equal_var=False)
    result = difference(*([scored(np.full(20, mean)) for mean in means] for means in (ours, others)), "mse")
    assert result.p == pytest.approx(expected.pvalue)
    assert result[1:3] == pytest.approx(tuple(expected.confidence_interval()))


def test_ratios_are_linearised() -> None:
    """With equal denominators, a ratio is a mean; a cluster with twice the denominator is not two clusters."""
    rng = np.random.default_rng(1)
    parts, size, clusters = rng.normal(size=(2, 30)), np.full(30, 2.0), np.arange(30) // 2

    def explained(part: np.ndarray, size: np.ndarray) -> list[Scores]:
        return [Scores(np.arange(30), clusters, np.zeros(30), {"explained": Ratio(part, size)})]

    as_means = difference(*([scored(part / size, clusters)] for part in parts), "mse")
    assert difference(*(explained(part, size) for part in parts), "explained") == pytest.approx(as_means)
    doubled = difference(*(explained(2 * part, 2 * size) for part in parts), "explained")
    assert doubled == pytest.approx(as_means)


def test_too_few_clusters_have_no_interval_and_equal_methods_do_not_differ() -> None:
    few = difference([scored(np.arange(5.0))], [scored(np.ones(5))], "mse")
    assert few.value == 1.0
    assert np.isnan(few[1:]).all()
    same = [scored(np.arange(8.0))]
    assert difference(same, same, "mse") == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("seeds", [1, 3])
def test_without_a_difference_p_is_uniform_or_larger_and_the_interval_covers(seeds: int) -> None:
    rng, results = np.random.default_rng(seeds), []
    for _ in range(200):
        experiment = rng.exponential(size=60)  # hard for both methods alike
        methods = [
            [
                scored(
                    experiment + 0.3 * rng.normal() * (seeds > 1) + 0.5 * np.repeat(rng.normal(size=30), 2),
                    np.arange(60) // 2,
                )
                for _ in range(seeds)
            ]
            for _ in range(2)
        ]
        results.append(difference(*methods, "mse"))
    p = np.array([result.p for result in results])
    assert 0.92 <= np.mean([result.low <= 0 <= result.high for result in results]) <= 0.99
    assert kstest(p, "uniform", alternative="greater").pvalue > 0.001
    assert np.mean(p < 0.5) > 0.35


def leave_runs(outputs: Path, **errors: np.ndarray | float) -> None:
    """Leave one run per model that is off by so much in every coordinate."""
    for model, error in errors.items():
        place = Path(*PLACE.parts[:2], model, *PLACE.parts[3:])
        leave(outputs / place, json.dumps(content(model=model, variant="")), error=float(error))


def test_methods_are_named_as_on_the_command_line(tmp_path: Path) -> None:
    leave_runs(tmp_path, cophynet=1.0, copy_c=2.0)
    changed = PLACE.with_name("seed0+size-small+max_epochs-7+hidden_dim-8")
    leave(tmp_path / changed, json.dumps(content(variant="+size-small+max_epochs-7+hidden_dim-8")), error=3.0)
    frame = compare_methods(tmp_path, ["cophynet", "copy_c", "cophynet+hidden_dim-8"])
    mse = frame[frame["measure"] == "mse"]
    assert list(zip(mse["method"], mse["other"], mse["difference"], strict=True)) == [
        ("CoPhyNet", "Copy C", -3.0),
        ("CoPhyNet", "CoPhyNet (hidden_dim-8)", -8.0),
        ("Copy C", "CoPhyNet (hidden_dim-8)", -5.0),
    ]
    with pytest.raises(CophyError, match=r".* has no run of npe; there are cophynet, cophynet\+hidden_dim-8, copy_c"):
        compare_methods(tmp_path, ["cophynet", "npe"])
    with pytest.raises(CophyError, match="two or more methods"):
        compare_methods(tmp_path, ["cophynet"])


def test_estimated_positions_are_another_method(tmp_path: Path) -> None:
    for positions, error in (("ground_truth", 1.0), ("derendered", 2.0)):
        place = PLACE.parents[1] / positions / PLACE.name
        leave(tmp_path / place, json.dumps(content(positions=positions, variant="")), error=error)
    frame = compare_methods(tmp_path, ["cophynet@derendered", "cophynet"])
    assert frame["difference"].iloc[0] == 3.0
    assert frame["method"].iloc[0] == "CoPhyNet (estimated positions)"


def test_other_experiments_are_not_compared(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    leave_runs(tmp_path, cophynet=1.0, copy_c=2.0)
    path = tmp_path / Path(*PLACE.parts[:2], "copy_c", *PLACE.parts[3:]) / "predictions.npz"
    arrays = dict(np.load(path))
    np.savez_compressed(path, **(arrays | {"target": arrays["target"] + 1}))
    with pytest.raises(CophyError, match="no two of"):
        compare_methods(tmp_path, ["cophynet", "copy_c"])
    assert "CoPhyNet and Copy C were tested on different experiments" in " ".join(caplog.text.split())


CLUSTERS = 20


def mean_with(p: float) -> np.ndarray:
    """Values whose mean is above 0, with this p-value of a two-sided t test."""
    values = np.tile([-1.0, 1.0], CLUSTERS // 2)
    return values + student_t.isf(p / 2, CLUSTERS - 1) * values.std(ddof=1) / CLUSTERS**0.5


def both_measures(mse: np.ndarray | float, explained: np.ndarray | float = 0.0, truth: float = 0.0) -> Scores:
    index, zeros = np.arange(CLUSTERS), np.zeros(CLUSTERS)
    values = {"mse": zeros + mse, "twin_difference_explained": Ratio(zeros + explained, zeros + 1.0)}
    return Scores(index, index, zeros + truth, values)


@pytest.fixture
def leave_scores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A function that leaves a run whose predictions have these scores."""
    scores_of: dict[Path, Scores] = {}
    monkeypatch.setattr("cophy.report.comparisons.stored_scores", lambda run: scores_of[run["directory"]])

    def leave_run(scores: Scores, **names: Any) -> None:
        metrics = content(**{"variant": ""} | names)
        directory = tmp_path.joinpath(*(metrics[name] for name in FOLDERS))
        directory /= f"seed{metrics['seed']}{metrics['variant']}"
        leave(directory, json.dumps(metrics))
        scores_of[directory] = scores

    return leave_run


def outcomes(frame: pd.DataFrame, measure: str) -> list[int]:
    return frame[frame["measure"] == measure]["outcome"].tolist()


@pytest.mark.parametrize("measure", ["mse", "twin_difference_explained"])
def test_the_better_method_wins_whether_or_not_higher_is_better(
    measure: str, leave_scores: Callable[..., None], tmp_path: Path
) -> None:
    """CoPhyNet is better than IN in two columns and equal to it in the third."""
    for split, better in (("3to3", 1.0), ("3to4", 1.0), ("4to4", 0.0)):
        leave_scores(both_measures(2.0 - better, 1.0 + better), model="cophynet", split=split)
        leave_scores(both_measures(2.0, 1.0), model="in", split=split)
    for names, expected in ((["cophynet", "in"], [1, 1, 0]), (["in", "cophynet"], [-1, -1, 0])):
        frame = compare_methods(tmp_path, names)
        assert outcomes(frame, measure) == expected
        (table,) = count_tables(frame[frame["measure"] == measure])
        assert table.cells.loc["CoPhyNet", "IN"].ours == "2 / 1 / 0"
        assert table.cells.loc["IN", "CoPhyNet"].ours == "0 / 1 / 2"


def test_a_difference_that_the_correction_removes_is_a_tie(leave_scores: Callable[..., None], tmp_path: Path) -> None:
    """Each measure is corrected for its own tests alone."""
    p = {"mse": [0.04, 0.5, 0.9], "twin_difference_explained": [0.01, 0.02, 0.03]}
    for split, *both in zip(("3to3", "3to4", "4to4"), *p.values(), strict=True):
        leave_scores(both_measures(*map(mean_with, both)), model="cophynet", split=split)
        leave_scores(both_measures(0.0), model="in", split=split)
    frame = compare_methods(tmp_path, ["cophynet", "in"])
    for measure, values in p.items():
        lines = frame[frame["measure"] == measure]
        assert lines["p"].tolist() == pytest.approx(values)
        assert lines["p_adjusted"].tolist() == pytest.approx(false_discovery_control(values))
    assert (outcomes(frame, "mse"), outcomes(frame, "twin_difference_explained")) == ([0, 0, 0], [1, 1, 1])
    printed = [table.cells.map(lambda cell: cell.ours) for table in comparison_tables(frame)]
    assert [table["difference"].str.endswith("*").tolist() for table in printed] == [[False] * 3, [True] * 3]
    assert printed[0]["p"].tolist() == ["0.120", "0.750", "0.900"]


def test_rows_of_tables_are_names_of_methods(leave_scores: Callable[..., None], tmp_path: Path) -> None:
    leave_scores(both_measures(1.0), model="in", ablation="gt_confounders")
    leave_scores(both_measures(2.0), model="in")
    for name in ("in_sup", "in_gt_confounders"):
        frame = compare_methods(tmp_path, [name, "in"])
        assert frame[["method", "other"]].drop_duplicates().to_numpy().tolist() == [["IN with true confounders", "IN"]]


def test_each_data_seed_is_a_column(leave_scores: Callable[..., None], tmp_path: Path) -> None:
    for model, better in (("cophynet", 1.0), ("in", 0.0)):
        leave_scores(both_measures(2.0 - better), model=model)
        leave_scores(both_measures(4.0 + better, truth=1.0), model=model, variant="+data_seed-1")
    frame = compare_methods(tmp_path, ["cophynet", "in"])
    assert outcomes(frame, "mse") == [1, -1]
    table, _ = comparison_tables(frame)
    assert table.cells.index.tolist() == ["blocktower 3→3", "blocktower 3→3 data seed 1"]


def test_seeds_that_were_tested_on_different_data_are_not_compared(
    leave_scores: Callable[..., None], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    leave_scores(both_measures(2.0), model="copy_c")
    for seed in (0, 1):
        leave_scores(both_measures(1.0, truth=float(seed)), model="cophynet", seed=seed)
    with pytest.raises(CophyError, match="no two of cophynet, copy_c were tested on the same experiments"):
        compare_methods(tmp_path, ["cophynet", "copy_c"])
    assert "its seeds were tested on different data: not compared" in " ".join(caplog.text.split())


def test_wins_ties_and_losses_are_those_of_corrected_tests() -> None:
    lines = pd.DataFrame({
        "scenario": "collision", "split": ["a", "b", "c", "d"], "size": "small", "data": "", "measure": "mse",
        "method": "A", "other": "B", "p": [0.001, 0.04, 0.01, np.nan], "outcome": [1, 0, -1, 0],
    })  # fmt: skip
    (table,) = count_tables(lines)
    assert table.cells.loc["A", "B"].ours == table.cells.loc["B", "A"].ours == "1 / 1 / 1"
    assert "collision d" not in table.caption


def test_all_pairs_are_written_and_those_of_the_first_method_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("cophy.report.comparisons.MIN_CLUSTERS", 2)
    leave_runs(tmp_path, cophynet=1.0, copy_c=2.0, npe=1.0)
    write_comparisons(tmp_path, tmp_path / "report", ["cophynet", "copy_c", "npe"])
    printed = capsys.readouterr().out
    assert "CoPhyNet vs Copy C: test MSE" in printed
    assert "Copy C vs NPE: test MSE" not in printed
    assert max(map(len, printed.splitlines())) <= 80
    markdown, latex = ((tmp_path / "report" / f"comparisons.{kind}").read_text() for kind in ("md", "tex"))
    assert "Copy C vs NPE: test MSE" in markdown
    assert markdown.count("## ") == 8  # 3 pairs and a count for each measure
    assert latex.count(r"\toprule") == 4
    assert latex.count("Difference: first") == markdown.count("Difference: first") == 1
    assert "intervals are not corrected" in markdown
    assert "Copy C vs NPE & 4.000 & 1.000 & +3.000$^*$ & $<$ 0.001" in latex
    assert "-3.000*" in markdown  # without an interval that has no width
    assert "-3.000, -3.000" not in markdown
    frame = pd.read_csv(tmp_path / "report" / "comparisons.csv")
    mse = frame[frame["measure"] == "mse"]
    assert mse["p_adjusted"].to_numpy() == pytest.approx(false_discovery_control(mse["p"]))


def test_rounding_hides_no_sign() -> None:
    assert [_signed(value, 3) for value in (-0.00047, 0.0123, 0.0, -1e-17)] == ["-0.0005", "0.012", "0.000", "0.000"]
    assert _signed(0.00002, 3, "+") == "+0.00002"


def test_too_few_clusters_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    leave_runs(tmp_path, cophynet=1.0, copy_c=2.0)
    write_comparisons(tmp_path, tmp_path / "report", ["cophynet", "copy_c"])
    printed = " ".join(capsys.readouterr().out.split())
    assert "Too few clusters of test experiments: 2; intervals and tests need 6 or more." in printed


def test_a_single_name_is_advised_a_second() -> None:
    with pytest.raises(HydraException) as refused:
        settings("report", "compare=in")
    assert explain(refused.value) == "compare=in must be a list: 'compare=[in,another]'"
