"""The paper's tables, filled from runs whose numbers are known; errors and shares of stored predictions."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from cophy.report.paper_tables import paper_tables
from cophy.report.predictions import stored_scores
from cophy.report.render import caption, latex, markdown, paper_text_tables, share_cells, table_cells
from cophy.report.tables import FilledTable, fill, share_of_gain
from cophy.training.predictor import prediction_arrays
from cophy.training.run import write_predictions
from cophy.types import Batch, Prediction
from tests.report.lines import measured, run, scores_of_mse

TABLES = {table.id: table for table in paper_tables()}


def cells(filled: FilledTable, bold: tuple[str, str] = ("", "")) -> pd.DataFrame:
    """The table as text."""
    return table_cells(filled).map(lambda cell: cell.line(bold))


def shares_of(filled: FilledTable) -> pd.DataFrame:
    """The shares as text."""
    return share_cells(filled).map(lambda cell: cell.line())


def test_the_best_of_the_comparable_methods_is_bold_at_the_papers_size() -> None:
    runs = pd.DataFrame(
        [measured("mse", 0.4, "copy_c"), measured("mse", 0.2, "cophynet"), measured("mse", 0.1, "in", "gt_confounders")]
    )
    small = fill(TABLES["blocktower"], runs)
    assert "**" not in "".join(cells(small, ("**", "**")).to_numpy().flat)
    assert "nothing is in bold" in caption(small)
    runs["size"] = "paper"
    texts = cells(fill(TABLES["blocktower"], runs), ("**", "**")).loc["3→3"]
    assert texts["Copy C"] == "0.400 [0.390, 0.420] / 0.470"
    assert texts["CoPhyNet"] == "**0.200** [0.190, 0.220] / 0.294"
    assert texts["IN with true confounders"] == "0.100 [0.090, 0.120] / 0.296"  # a bound does not compete
    assert texts["NPE"] == "— / 0.331"


def test_accuracies_are_percent_and_higher_is_better() -> None:
    metric = "sequence_stability_accuracy"
    runs = pd.DataFrame([measured(metric, 0.5, "copy_c"), measured(metric, 0.75, "cophynet")]).assign(size="paper")
    texts = cells(fill(TABLES["stability"], runs), ("**", "**"))["3→3"]
    assert texts["CoPhyNet"] == "**75.0** [74.0, 77.0] / 76.8"
    assert texts["Copy C"] == "50.0 [49.0, 52.0] / 71.0"


def test_the_share_of_the_possible_gain_is_between_the_oracles() -> None:
    models = {"oracle_feedforward": 0.3, "oracle_counterfactual": 0.1, "cophynet": 0.15, "in": 0.3, "copy_c": 0.4}
    filled = fill(TABLES["blocktower"], pd.DataFrame([measured("mse", mse, model) for model, mse in models.items()]))
    shares = shares_of(filled)
    assert shares.loc["3→3", ["CoPhyNet", "IN", "Copy C", "NPE"]].tolist() == ["75%", "0%", "-50%", "—"]
    assert not any("Oracle" in column for column in shares.columns)
    assert not filled.values.set_index(["row", "column"])["best"]["3→3", "Oracle with AB"]  # it does not compete
    assert "75%" in markdown(paper_text_tables(filled, whole=False)[1])
    without = pd.DataFrame([measured("mse", 0.2, "cophynet")])
    assert fill(TABLES["blocktower"], without).shares().empty


def test_what_is_given_to_other_oracles_does_not_move_the_share() -> None:
    models = {"oracle_feedforward": 0.3, "oracle_counterfactual": 0.1, "cophynet": 0.15}
    given = {"oracle_initial_velocity": 0.25, "oracle_confounders": 0.0}
    lines = [measured("mse", mse, model) for model, mse in (models | given).items()]
    filled = fill(TABLES["blocktower"], pd.DataFrame(lines))
    shares, texts = shares_of(filled), cells(filled)
    assert shares.loc["3→3", "CoPhyNet"] == "75%"
    assert texts.loc["3→3", "Oracle with initial velocity"].startswith("0.250")
    assert texts.loc["3→3", "Oracle with confounders"].startswith("0.000")
    assert not filled.values["best"][filled.values["column"].str.startswith("Oracle")].any()


def test_a_caption_says_what_oracles_know_where_there_are_some() -> None:
    runs = pd.DataFrame([measured("mse", 0.3, "oracle_feedforward")])
    assert "beyond positions: object type and pose" in caption(fill(TABLES["blocktower"], runs))
    assert "Oracles" not in caption(fill(TABLES["blocktower"], pd.DataFrame([measured("mse", 0.3, "in")])))


def test_the_interval_of_a_share_is_paired_over_twin_pairs() -> None:
    """The three rows err alike from pair to pair, so that the share is surer than any of them."""
    rng, pair = np.random.default_rng(0), np.arange(400) // 2
    hard = rng.exponential(1.0, 200)[pair]
    models = {"oracle_feedforward": 0.3, "oracle_counterfactual": 0.1, "cophynet": 0.15}

    scores = {
        Path(model): scores_of_mse(mse * hard + rng.normal(0.0, 0.002, 400), pair) for model, mse in models.items()
    }
    runs = pd.DataFrame([measured("mse", mse, model, directory=Path(model)) for model, mse in models.items()])
    filled = fill(TABLES["blocktower"], runs, scores)
    value = filled.values.set_index(["row", "column"]).loc[("3→3", "CoPhyNet")]
    assert 0.74 < value["share_low"] < 0.75 < value["share_high"] < 0.76
    shares = shares_of(filled)
    assert shares.loc["3→3", "CoPhyNet"] == "75% [75%, 75%]"
    assert shares.loc["3→3", "NPE"] == "—"


def test_the_share_of_an_accuracy_grows_with_it() -> None:
    metric = "sequence_stability_accuracy"
    models = {"oracle_feedforward": 0.7, "oracle_counterfactual": 0.9, "cophynet": 0.8}
    runs = pd.DataFrame([measured(metric, value, model) for model, value in models.items()]).assign(mse=0.1)
    scores = scores_of_mse(np.full(4, 0.1), np.arange(4) // 2)  # intervals are of the MSE, not of an accuracy
    filled = fill(TABLES["stability"], runs, {Path("runs"): scores})
    shares = shares_of(filled)
    assert shares.loc["CoPhyNet", "3→3"] == "50%"


def test_oracles_alone_and_on_fewer_experiments_make_no_shares() -> None:
    """At the paper's size oracles are asked about 400 test experiments of 4,044; accuracies are means over all."""
    metric = "sequence_stability_accuracy"
    oracles = [
        measured(metric, value, f"oracle_{name}") for name, value in (("feedforward", 0.7), ("counterfactual", 0.9))
    ]
    for lines in (oracles, [*oracles, measured(metric, 0.8, "cophynet", num_test=4044)]):
        assert fill(TABLES["stability"], pd.DataFrame(lines)).shares().empty


def test_seeds_are_averaged_and_a_failed_one_is_counted() -> None:
    runs = pd.DataFrame([measured("mse", value, "cophynet", seed=seed) for seed, value in enumerate((0.1, 0.2, 0.3))])
    failed = pd.DataFrame([run("cophynet", seed=3, error="boom"), run("npe", error="boom")])
    failed = failed.drop(columns=["num_train", "num_test", "epochs"])  # which a run has once it is done
    filled = fill(TABLES["blocktower"], pd.concat([runs, failed]))
    assert cells(filled).loc["3→3", "CoPhyNet"] == "0.200 ± 0.100 [0.190, 0.220] (1 failed) / 0.294"
    assert cells(filled).loc["3→3", "NPE"] == "failed / 0.331"
    assert "seeds 0, 1, 2" in caption(filled)
    assert "2800 training and 400 test experiments; 40 epochs" in caption(filled)


def test_a_cell_averages_no_runs_of_different_lengths_or_sizes() -> None:
    runs = [
        measured("mse", 0.1, "cophynet", epochs=120),
        measured("mse", 0.3, "cophynet", seed=1, epochs=40),
        measured("mse", 0.9, "cophynet", seed=2, epochs=400, num_train=280, size="tiny"),
        measured("mse", 0.5, "copy_c", epochs=40, is_trained=False),
    ]
    filled = fill(TABLES["blocktower"], pd.DataFrame(runs))
    assert cells(filled).loc["3→3", "CoPhyNet"] == "0.100 [0.090, 0.120] / 0.294"
    assert "test experiments; 120 epochs; seeds 0." in caption(filled)
    copies = fill(TABLES["blocktower"], pd.DataFrame(runs[-1:]))
    assert "400 test experiments; seeds 0." in caption(copies)


def test_a_caption_says_which_positions_were_tested() -> None:
    runs = pd.DataFrame([measured("mse", 0.1, "cophynet")])
    assert "Tested on true positions." in caption(fill(TABLES["blocktower"], runs))
    estimated = runs.assign(positions="train_ground_truth_test_derendered")
    assert "Tested on positions estimated" in caption(fill(TABLES["blocktower_derendered"], estimated))


def test_a_caption_has_the_numbers_of_controls_that_were_run() -> None:
    shown = [measured("mse", 0.3, "cophynet", split="3to3_unseen", epochs=80)]
    control = [measured("mse", 0.25, "cophynet", split="3to3_seen", seed=seed, epochs=80) for seed in (0, 1)]
    control += [measured("mse", 0.4, "copy_c", split="3to3_seen", epochs=80)]
    words = "tested on combinations seen in training, in other geometries"
    assert words not in caption(fill(TABLES["blocktower"], pd.DataFrame(shown)))
    filled = fill(TABLES["blocktower"], pd.DataFrame(shown + control))
    numbers = f"{words}: Copy C 0.400 [0.390, 0.420], CoPhyNet 0.250 ± 0.000 [0.240, 0.270]."
    assert caption(filled).endswith(numbers)
    assert cells(filled).loc["3→3 †", "CoPhyNet"].startswith("0.300")


def test_estimated_positions_fill_tables_of_their_own_and_name_the_derenderer() -> None:
    estimated = {"positions": "train_ground_truth_test_derendered", "derenderer": "0123abcd"}
    runs = pd.DataFrame([measured("mse", 0.2, "cophynet"), measured("mse", 0.3, "cophynet", **estimated)])
    assert cells(fill(TABLES["blocktower"], runs)).loc["3→3", "CoPhyNet"].startswith("0.200")
    filled = fill(TABLES["blocktower_derendered"], runs)
    assert cells(filled).loc["3→3", "CoPhyNet"].startswith("0.300")
    assert "de-renderer 0123abcd" in caption(filled)
    trained = cells(fill(TABLES["training_positions"], runs))
    assert trained.loc["3→3", "CoPhyNet, trained on true positions"].startswith("0.300")
    assert trained.loc["3→3", "CoPhyNet, trained on estimated positions"].startswith("—")


def test_runs_of_a_smaller_size_do_not_mix_in() -> None:
    runs = pd.DataFrame(
        [measured("mse", 0.2, "cophynet"), measured("mse", 0.9, "cophynet", seed=1, size="tiny", num_train=28)]
    )
    filled = fill(TABLES["blocktower"], runs)
    assert cells(filled).loc["3→3", "CoPhyNet"].startswith("0.200 [")
    assert caption(filled).endswith("A table is of one size; runs of another are left out: tiny.")


def test_a_smaller_size_does_not_fill_what_the_larger_leaves_open() -> None:
    """Shares and the best would compare errors on different data."""
    tiny = [measured("mse", 0.9, name, size="tiny", num_train=28) for name in ("in", "oracle_feedforward")]
    failed = run("npe", size="tiny", error="boom")
    texts = cells(fill(TABLES["blocktower"], pd.DataFrame([measured("mse", 0.2, "cophynet"), *tiny, failed])))
    assert texts.loc["3→3", ["IN", "NPE"]].tolist() == ["— / 0.318", "— / 0.331"]
    assert cells(fill(TABLES["blocktower"], pd.DataFrame(tiny))).loc["3→3", "IN"].startswith("0.900")


def test_failed_runs_alone_fill_no_number() -> None:
    runs = pd.DataFrame([run("npe", error="boom")]).drop(columns="num_train")
    assert cells(fill(TABLES["blocktower"], runs)).loc["3→3", ["IN", "NPE"]].tolist() == [
        "— / 0.318",
        "failed / 0.331",
    ]


@pytest.mark.parametrize("table", TABLES)
def test_every_format_shows_the_number(table: str) -> None:
    choice = next(names for _, _, names, _ in TABLES[table].cells() if "participants" not in names)
    metric = choice.pop("metric")
    runs = pd.DataFrame([measured(metric, 0.123, **{**choice, "seed": 0})])
    filled = fill(TABLES[table], runs)
    shown = f"{0.123 * TABLES[table].scale:.{TABLES[table].digits}f}"
    for whole in (False, True):
        shown_table, *_ = paper_text_tables(filled, whole=whole)
        for text in (markdown(shown_table), latex(shown_table)):
            assert shown in text
        assert latex(shown_table).isascii()
        assert whole or (shown_table.cells.map(lambda cell: cell.ours) != "—").any(axis=None)


def test_every_number_of_the_paper_has_a_cell_and_no_other_table() -> None:
    for table in paper_tables():
        assert len(table.paper) == len(table.rows)
        assert all(len(row) == len(table.columns) for row in table.paper)
    assert TABLES["stability"].paper[4] == [85.4, 77.3]
    assert TABLES["blocktower"].paper[5][:6] == [0.480, 0.618, 0.342, 0.350, 0.301, 0.297]
    assert TABLES["collision_derendered"].paper[2][5] == 0.586
    assert set(TABLES["collision_derendered"].paper[2][6:]) == {None}
    assert TABLES["human_comparison_derendered"].paper[0] == [65.41, 25.51, 7.36, 32.76]


@pytest.mark.parametrize("variance", [None, 0.25])
@pytest.mark.parametrize("dims", [2, 3])
def test_stored_scores_are_the_mse_of_each_experiment(
    dims: int, variance: float | None, tower_batch: Batch, tmp_path: Path
) -> None:
    position = tower_batch.inputs.observed[:, 1:]
    prediction = Prediction(position, draw_variance=None if variance is None else variance * torch.rand_like(position))
    targets = tower_batch.targets
    write_predictions(tmp_path, prediction_arrays(prediction, targets, np.arange(len(targets)), targets.pair.numpy()))
    scores = stored_scores({"directory": tmp_path, "metric_dims": dims})
    squared = (position.double() - targets.position).square() - (0.0 if variance is None else prediction.draw_variance)
    present = targets.presence[:, None, :, None].expand_as(squared)[..., :dims]
    expected = squared[..., :dims].where(present, torch.nan).nanmean(dim=(1, 2, 3))
    np.testing.assert_allclose(scores.mse, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(scores.cluster, np.arange(len(targets)) // 2)


def test_a_share_is_of_the_experiments_that_all_were_tested_on() -> None:
    pairs = np.arange(40) // 2
    ours = [scores_of_mse(np.where(pairs < 10, 2.0, 100.0), pairs)]
    without, with_ab = ([scores_of_mse(np.full(20, mse), pairs[:20])] for mse in (5.0, 1.0))
    assert share_of_gain(ours, without, with_ab) == pytest.approx((0.75, 0.75, 0.75))
    turned = [each.select(np.arange(20)[::-1]) for each in with_ab]  # matched by their ids
    assert share_of_gain(ours, without, turned) == pytest.approx((0.75, 0.75, 0.75))
    none_in_common = [replace(each, experiment=each.experiment + 40) for each in with_ab]
    assert np.isnan(share_of_gain(ours, without, none_in_common).value)
    other_pairs = [replace(each, cluster=each.cluster + 1) for each in with_ab]
    assert np.isnan(share_of_gain(ours, without, other_pairs).value)
    other_data = [replace(each, truth=each.truth + 0.5) for each in with_ab]  # whose experiments have the same numbers
    assert np.isnan(share_of_gain(ours, without, other_data).value)
    assert np.isnan(share_of_gain([], without, with_ab).value)


def test_an_interval_of_a_paper_table_has_a_width_and_a_deviation_may_be_zero() -> None:
    same = [measured("mse", 0.3, "cophynet", seed=seed) | {"low.mse": 0.3, "high.mse": 0.3} for seed in (0, 1)]
    copies = [measured("mse", 0.3, "copy_c", seed=seed, is_trained=False) for seed in (0, 1)]
    texts = cells(fill(TABLES["blocktower"], pd.DataFrame([*same, *copies]))).loc["3→3"]
    assert texts["CoPhyNet"] == "0.300 ± 0.000 / 0.294"
    assert texts["Copy C"] == "0.300 [0.290, 0.320] / 0.470"
