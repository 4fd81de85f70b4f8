"""Means over experiments, and how sure they are."""

import numpy as np
import pytest

from cophy.bootstrap import Ratio, interval, mean, variance_of_mean


def test_experiments_that_do_not_count_are_left_out() -> None:
    assert mean(np.array([1.0, np.nan, 3.0])) == 2.0


def test_the_interval_covers_the_mean_as_often_as_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the experiments of a cluster err alike."""
    monkeypatch.setattr("cophy.bootstrap.NUM_RESAMPLES", 400)
    rng = np.random.default_rng(0)
    for alike in (1, 2):
        samples = (np.repeat(rng.exponential(1.0, 200 // alike), alike) for _ in range(300))
        covered = [low <= 1.0 <= high for low, high in (interval(sample, np.arange(200) // 2) for sample in samples)]
        assert 0.90 <= np.mean(covered) <= 0.97


def test_the_interval_leaves_out_what_does_not_count() -> None:
    values = np.random.default_rng(0).normal(size=400)
    holes = np.concatenate([values, np.full(40, np.nan)])
    clusters = np.arange(440) // 2
    assert interval(holes, clusters) == pytest.approx(interval(values, clusters[:400]))


def test_items_of_a_cluster_are_resampled_together_however_many_there_are() -> None:
    clusters = np.array([0, 0, 0, 7, 7])
    assert interval(np.array([1.0, 1.0, 1.0, 2.0, 2.0]), clusters) == (1.0, 2.0)
    assert interval(np.array([1.0, 2.0, 3.0]), np.zeros(3, dtype=int)) == (2.0, 2.0)


def test_a_ratio_is_of_sums_and_its_interval_covers_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cophy.bootstrap.NUM_RESAMPLES", 400)
    rng, truth, covered = np.random.default_rng(0), 0.25, []
    for _ in range(200):
        size = rng.exponential(1.0, 150)
        ratio = Ratio(size * rng.choice([0.0, 0.5], 150), size)
        low, high = interval(ratio, np.arange(150))
        covered.append(low <= truth <= high)
    assert mean(Ratio(np.array([1.0, 3.0]), np.array([2.0, 8.0]))) == 0.4
    assert 0.89 <= np.mean(covered) <= 0.98


def test_columns_weigh_the_same_however_many_experiments_they_have() -> None:
    """Table 1: of 100 towers half have no top block; the mean is that of the top's mean and the bottom's."""
    rng = np.random.default_rng(0)
    bottom, top = rng.normal(1.0, 0.1, 100), np.where(np.arange(100) % 4 < 2, rng.normal(9.0, 3.0, 100), np.nan)
    both, clusters = np.stack([bottom, top], axis=1), np.arange(100) // 2
    assert mean(both) == pytest.approx((bottom.mean() + np.nanmean(top)) / 2)
    ends, ends_of_top = interval(both, clusters), interval(top, clusters)
    assert ends[0] < mean(both) < ends[1]
    assert ends[1] - ends[0] == pytest.approx((ends_of_top[1] - ends_of_top[0]) / 2, rel=0.2)
    assert interval(bottom[:, None], clusters) == pytest.approx(interval(bottom, clusters))


def test_a_column_without_experiments_has_no_weight() -> None:
    values = np.array([[1.0, np.nan], [3.0, np.nan]])
    assert mean(values) == 2.0
    assert interval(values, np.arange(2))[0] == 1.0


def test_a_draw_without_a_rare_column_is_of_the_others() -> None:
    rare = np.array([[1.0, 5.0], [2.0, np.nan], [3.0, np.nan]])
    assert all(1.0 <= end <= 5.0 for end in interval(rare, np.arange(3)))


def test_the_variance_of_a_mean_is_that_over_clusters() -> None:
    values = np.random.default_rng(0).normal(size=(40, 3))
    clusters = np.arange(40) // 4
    means = values.reshape(10, 4, 3).mean(axis=1)
    variance, degrees = variance_of_mean(values, clusters)
    assert variance == pytest.approx(means.var(axis=0, ddof=1) / 10)
    assert degrees == 9
    holes = np.concatenate([values[:, 0], np.full(4, np.nan)])
    assert variance_of_mean(holes, np.arange(44) // 4) == pytest.approx((variance[0], 9))
