"""Simulated participants go through the pages; they are as wrong as they should be, and never people."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cophy.study.answers import PERSON, AnswerStore
from cophy.study.judging import human_rows, judge, read_clicks
from cophy.study.server import OpenStudy
from cophy.study.sessions import Assignment
from cophy.study.simulation import MEAN_ERROR, STRATEGIES, differences, people_needed, power_curve, take_study
from tests.study.conftest import GENEROUS, Site, take_one


def simulated(site: Site, kind: str, participants: int = 4) -> OpenStudy:
    """Simulated participants of a kind took the site's study."""
    study = OpenStudy(site.study.sessions.of_kind(kind), site.study.experiments, site.study.clips)
    take_study(study, study.app(None, GENEROUS), STRATEGIES[kind], participants=participants, seed=0)
    return study


def rows_of(site: Site, path: Path) -> pd.DataFrame:
    return human_rows(judge(read_clicks(path, site.study.sessions.study), site.study.experiments.scenes))


def test_they_stand_apart_from_people(site: Site, tmp_path: Path) -> None:
    person = site.participant()
    for _ in range(4):
        take_one(person)
    simulated(site, "stays")
    rows = rows_of(site, tmp_path / "answers.sqlite")
    means = rows[rows["measure"] == "mean"].set_index(["kind", "setting"])
    assert set(rows["kind"]) == {PERSON, "stays"}
    assert means["participants"].to_dict() == {
        **{(PERSON, setting): 1 for setting in ("cf", "non_cf")},
        **{("stays", setting): 4 for setting in ("cf", "non_cf")},
    }


def test_who_says_that_nothing_moves_is_as_wrong_as_things_move(site: Site, tmp_path: Path) -> None:
    simulated(site, "stays")
    rows = rows_of(site, tmp_path / "answers.sqlite")
    scenes, experiments = site.study.experiments.scenes, site.study.experiments
    moved = []
    for number in range(4):
        for experiment, setting in experiments.plan(number):
            if setting == "cf":
                starts, ends = scenes.starts(experiment), scenes.ends(experiment)
                moved.append(np.mean([np.hypot(*np.subtract(starts[slot], ends[slot])) for slot in starts]))
    found = rows[(rows["measure"] == "mean") & (rows["setting"] == "cf")]["mean"]
    assert found.to_numpy() == pytest.approx(448 / 64 * np.mean(moved), rel=1e-6)


def test_the_noisy_oracle_is_as_wrong_as_the_papers_people(site: Site) -> None:
    """Over 4,000 answers, within 3 %; clicks are not cut at the edge here."""
    scenes, rng = site.study.experiments.scenes, np.random.default_rng(0)
    experiment = site.study.experiments.shown[0]
    ends = scenes.ends(experiment)
    for setting, mean in MEAN_ERROR.items():
        errors = []
        for _ in range(4000):
            clicks = STRATEGIES["noisy_oracle"](scenes, Assignment(experiment, setting), rng)
            errors.append(np.mean([np.hypot(*np.subtract(clicks[slot], ends[slot])) for slot in ends]) * 448 / 64)
        assert np.mean(errors) == pytest.approx(mean, rel=0.03)


def test_simulated_answers_are_the_same_again(site: Site, tmp_path: Path) -> None:
    simulated(site, "random")
    first = rows_of(site, tmp_path / "answers.sqlite")
    site.store.close()
    for path in tmp_path.glob("answers.sqlite*"):
        path.unlink()
    site.store = site.study.sessions.store = AnswerStore(tmp_path / "answers.sqlite")
    with site.store.transaction() as db:
        db.execute("INSERT INTO studies VALUES (?, ?)", (site.study.sessions.study, "{}"))
    simulated(site, "random")
    pd.testing.assert_frame_equal(first, rows_of(site, tmp_path / "answers.sqlite"))


def test_differences_are_paired_by_participant() -> None:
    """Participant 0: 5 - 1 without and with AB; 1: mean(4, 8) - 3; 2 has one setting only; practice does not count."""
    lines = [
        *[(0, "non_cf", 1, 5.0, 0), (0, "cf", 2, 1.0, 0), (0, "cf", 9, 100.0, 1)],
        *[(1, "non_cf", 1, 4.0, 0), (1, "non_cf", 3, 8.0, 0), (1, "cf", 2, 3.0, 0), (2, "cf", 1, 7.0, 0)],
    ]
    judged = pd.DataFrame(lines, columns=["participant", "setting", "experiment", "error", "practice"])
    assert differences(judged).tolist() == [4.0, 3.0]


def test_power_without_a_difference_is_the_chance_of_an_error_and_grows_with_one() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(size=2000)
    nothing = power_curve(noise - noise.mean(), seed=0)
    assert nothing["power"].max() < 0.05  # half of 5 %: the wrong side does not count
    helps = power_curve(noise - noise.mean() + 0.5, seed=0).set_index("people")["power"]
    assert helps.is_monotonic_increasing
    assert helps[30] == pytest.approx(0.75, abs=0.05)  # of a t-test with 30 draws and an effect of half an SD


def test_people_needed_lies_between_points() -> None:
    curve = pd.DataFrame({"people": [10, 20, 40], "power": [0.5, 0.7, 0.9]})
    assert people_needed(curve) == pytest.approx(30)
    assert np.isnan(people_needed(curve.assign(power=0.1)))
