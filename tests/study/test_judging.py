"""Errors and rows from answers that were given over HTTP."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cophy.study.judging import human_rows, judge, read_clicks
from tests.study.conftest import Site, answer_to, take_one


def finish(site: Site, shift: float) -> None:
    """One participant, who clicks so many pixels to the right of where each object ends."""
    browser = site.participant()
    while "code" not in (place := browser.get("/api/place").json()):
        assignment = site.study.sessions.place(browser.cookies["cophy_study"]).assignment
        assert assignment is not None
        ends = site.study.experiments.scenes.ends(assignment.experiment)
        content = answer_to(place)
        for click in content["clicks"]:
            click["x"], click["y"] = ends[click["slot"]][0] + shift, ends[click["slot"]][1]
        browser.post(f"/api/assignments/{place['position']}/begin", json={})
        assert browser.post(f"/api/assignments/{place['position']}/answer", json=content).status_code == 200


def test_errors_are_pixels_of_448(site: Site, tmp_path: Path) -> None:
    """2 pixels of 64 are 14 of 448; 4 are 28."""
    for shift in (2, 4):
        finish(site, shift)
    rows = human_rows(
        judge(read_clicks(tmp_path / "answers.sqlite", site.study.sessions.study), site.study.experiments.scenes)
    )
    assert set(rows["kind"]) == {"person"}
    lowest, rows = (rows[rows["measure"] == measure] for measure in ("rank_1", "mean"))
    assert rows["setting"].tolist() == ["cf", "non_cf"]
    assert lowest["mean"].to_numpy() == pytest.approx(21)
    assert rows["mean"].to_numpy() == pytest.approx(21)
    assert rows["sigma"].to_numpy() == pytest.approx(7)
    assert rows["low_people"].to_numpy() == pytest.approx(14)
    assert rows["high_people"].to_numpy() == pytest.approx(28)
    assert rows["answers"].tolist() == [2, 2]


def test_practice_and_what_is_missing_are_no_errors(site: Site, tmp_path: Path) -> None:
    browser = site.participant()
    take_one(browser)
    take_one(browser)
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/2/begin", json={})
    content = answer_to(place, clicks=answer_to(place)["clicks"][:1])
    assert browser.post("/api/assignments/2/answer", json=content).status_code == 200
    judged = judge(read_clicks(tmp_path / "answers.sqlite", site.study.sessions.study), site.study.experiments.scenes)
    assert set(judged["practice"]) == {0, 1}
    rows = human_rows(judged)
    rows = rows[rows["measure"] == "mean"]
    assert rows["answers"].tolist() == [1]
    assert rows["missing"].to_numpy() == pytest.approx(1 - 1 / len(place["objects"]))
    assert np.isfinite(rows["mean"]).all()


def test_other_studies_are_left_out(site: Site, tmp_path: Path) -> None:
    take_one(site.participant())
    assert read_clicks(tmp_path / "answers.sqlite", "another").empty


def test_the_mean_is_of_the_ranks_and_sigma_of_the_answers() -> None:
    """Two answers: 10 and 50 pixels off, and, where the top was removed, 30. So ranks have 20 and 50, answers 30 and 30."""
    clicks = {"experiment": [0, 0, 2], "rank": [1, 2, 1], "error": [10.0, 50.0, 30.0], "x": 1.0}
    same = {"kind": "person", "setting": "cf", "practice": 0, "participant": 1}
    rows = human_rows(pd.DataFrame(clicks | same)).set_index("measure")
    assert rows["mean"].to_dict() == {"rank_1": 20.0, "rank_2": 50.0, "mean": 35.0}
    assert rows["sigma"].to_dict() == {"rank_1": 10.0, "rank_2": 0.0, "mean": 0.0}
    assert rows["answers"].to_dict() == {"rank_1": 2, "rank_2": 1, "mean": 2}
