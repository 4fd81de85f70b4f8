"""Errors of clicks, and the rows of Table 1."""

import numpy as np
import pandas as pd
import pytest

from cophy.errors import CophyError
from cophy.study.judging import human_rows, judge, read_clicks
from tests.study.conftest import Site, answer_to, judged_of, take_task


def finish(site: Site, shift: float) -> None:
    """Let a participant click `shift` pixels to the right of where each object ends."""
    browser = site.participant()
    while "code" not in (place := browser.get("/api/place").json()):
        task = site.sessions.place(browser.cookies["cophy_study"]).task
        assert task is not None
        ends = site.sessions.experiments.scenes.ends(task.experiment)
        clicks = answer_to(place)["clicks"]
        for click in clicks:
            click["x"], click["y"] = ends[click["slot"]][0] + shift, ends[click["slot"]][1]
        take_task(browser, clicks=clicks)


def test_errors_are_pixels_of_448(site: Site) -> None:
    """2 pixels of 64 are 14 of 448, 4 are 28."""
    for shift in (2, 4):
        finish(site, shift)
    rows = human_rows(judged_of(site.path, site.sessions.experiments)[1])
    assert set(rows["kind"]) == {"person"}
    lowest, means = (rows[rows["measure"] == measure] for measure in ("rank_1", "mean"))
    assert means["setting"].tolist() == ["cf", "non_cf"]
    assert lowest["mean"].to_numpy() == pytest.approx(21)
    assert means["mean"].to_numpy() == pytest.approx(21)
    assert means["sigma"].to_numpy() == pytest.approx(7)
    assert means["low_people"].to_numpy() == pytest.approx(14)
    assert means["high_people"].to_numpy() == pytest.approx(28)
    assert means["answers"].tolist() == [2, 2]
    assert read_clicks(site.path, "another study").empty


def test_practice_and_missing_clicks_do_not_count_as_errors(site: Site) -> None:
    browser = site.participant()
    take_task(browser)
    take_task(browser)
    clicks = answer_to(browser.get("/api/place").json())["clicks"]
    take_task(browser, clicks=clicks[:1])
    _, judged = judged_of(site.path, site.sessions.experiments)
    assert set(judged["practice"]) == {0, 1}
    rows = human_rows(judged)
    rows = rows[rows["measure"] == "mean"]
    assert rows["answers"].tolist() == [1]
    assert rows["missing"].to_numpy() == pytest.approx(1 - 1 / len(clicks))
    assert np.isfinite(rows["mean"]).all()


def test_a_click_on_an_object_that_is_not_in_c_is_named(site: Site) -> None:
    finish(site, 2)
    scenes = site.sessions.experiments.scenes
    clicks = read_clicks(site.path, site.sessions.study)
    clicks.loc[0, "slot"] = next(iter({*range(4)} - {item["slot"] for item in scenes.objects(clicks["experiment"][0])}))
    with pytest.raises(CophyError, match="a click on an object that is not in C"):
        judge(clicks, scenes)


def test_the_mean_is_over_ranks_and_sigma_over_answers() -> None:
    """Two answers, with errors of 10 and 50, and of 30 where the top was removed: ranks 20 and 50, answers 30 and 30."""
    clicks = {"experiment": [0, 0, 2], "rank": [1, 2, 1], "error": [10.0, 50.0, 30.0], "x": 1.0}
    constant = {"kind": "person", "setting": "cf", "practice": 0, "participant": 1}
    rows = human_rows(pd.DataFrame(clicks | constant)).set_index("measure")
    assert rows["mean"].to_dict() == {"rank_1": 20.0, "rank_2": 50.0, "mean": 35.0}
    assert rows["sigma"].to_dict() == {"rank_1": 10.0, "rank_2": 0.0, "mean": 0.0}
    assert rows["answers"].to_dict() == {"rank_1": 2, "rank_2": 1, "mean": 2}
