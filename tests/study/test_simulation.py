"""Simulated participants have the errors that they should have, and are never counted as human participants."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cophy.study.answers import PERSON, AnswerStore
from cophy.study.experiments import StudyExperiments
from cophy.study.judging import human_rows
from cophy.study.plan import StudyTask
from cophy.study.sessions import Sessions
from cophy.study.simulation import (
    MEAN_ERROR,
    STRATEGIES,
    error_differences,
    participants_needed,
    power_curve,
    take_study,
)
from tests.study.conftest import Site, judged_of, take_task


def simulated_rows(path: Path, experiments: StudyExperiments, kind: str) -> pd.DataFrame:
    """Return the rows of a file after four simulated participants took the study."""
    store = AnswerStore(path)
    take_study(Sessions(store, experiments, kind), 4, seed=0)
    store.close()
    return human_rows(judged_of(path, experiments)[1])


def test_simulated_participants_are_separate_from_human_participants(site: Site) -> None:
    participant = site.participant()
    for _ in range(4):
        take_task(participant)
    rows = simulated_rows(site.path, site.sessions.experiments, "stays")
    counts = rows[rows["measure"] == "mean"].set_index(["kind", "setting"])["participants"]
    assert counts.to_dict() == {
        **{(PERSON, "cf"): 1, (PERSON, "non_cf"): 1},
        **{("stays", "cf"): 4, ("stays", "non_cf"): 4},
    }


def test_the_error_of_clicking_the_starts_is_the_displacement(experiments: StudyExperiments, tmp_path: Path) -> None:
    rows = simulated_rows(tmp_path / "answers.sqlite", experiments, "stays")
    moved = []
    for number in range(4):
        for task in experiments.tasks(number)[2:]:
            if task.setting == "cf":
                starts, ends = experiments.scenes.starts(task.experiment), experiments.scenes.ends(task.experiment)
                moved.append(np.mean([np.hypot(*np.subtract(starts[slot], ends[slot])) for slot in starts]))
    means = rows[(rows["measure"] == "mean") & (rows["setting"] == "cf")]["mean"]
    assert means.to_numpy() == pytest.approx(448 / 64 * np.mean(moved), rel=1e-6)


def test_the_noisy_oracle_has_the_mean_error_of_the_papers_participants(experiments: StudyExperiments) -> None:
    """Within 5 % over 2,000 answers, which are not moved to the edge of the image here."""
    scenes, rng, experiment = experiments.scenes, np.random.default_rng(0), experiments.shown[0]
    ends = scenes.ends(experiment)
    for setting, mean in MEAN_ERROR.items():
        errors = []
        for _ in range(2000):
            clicks = STRATEGIES["noisy_oracle"](scenes, StudyTask(experiment, setting), rng)
            errors.append(np.mean([np.hypot(*np.subtract(clicks[slot], ends[slot])) for slot in ends]) * 448 / 64)
        assert np.mean(errors) == pytest.approx(mean, rel=0.05)


def test_simulated_answers_are_reproducible(experiments: StudyExperiments, tmp_path: Path) -> None:
    first, second = (simulated_rows(tmp_path / name, experiments, "random") for name in ("a.sqlite", "b.sqlite"))
    pd.testing.assert_frame_equal(first, second)


def test_differences_are_paired_by_participant() -> None:
    """Participant 0: 5 - 1; participant 1: mean(4, 8) - 3; participant 2 has one setting only; practice is left out."""
    lines = [
        *[(0, "non_cf", 1, 5.0, 0), (0, "cf", 2, 1.0, 0), (0, "cf", 9, 100.0, 1)],
        *[(1, "non_cf", 1, 4.0, 0), (1, "non_cf", 3, 8.0, 0), (1, "cf", 2, 3.0, 0), (2, "cf", 1, 7.0, 0)],
    ]
    judged = pd.DataFrame(lines, columns=["participant", "setting", "experiment", "error", "practice"])
    assert error_differences(judged).tolist() == [4.0, 3.0]


def test_the_power_is_the_error_rate_without_an_effect_and_grows_with_one() -> None:
    noise = np.random.default_rng(0).normal(size=2000)
    noise -= noise.mean()
    assert power_curve(noise, seed=0)["power"].max() < 0.05  # half of 5 %: the wrong side does not count
    power = power_curve(noise + 0.5, seed=0).set_index("people")["power"]
    assert power.is_monotonic_increasing
    assert power[30] == pytest.approx(0.75, abs=0.05)  # t-test with 30 draws and an effect of half an SD


def test_the_number_of_participants_is_interpolated() -> None:
    curve = pd.DataFrame({"people": [10, 20, 40], "power": [0.5, 0.7, 0.9]})
    assert participants_needed(curve) == pytest.approx(30)
    assert participants_needed(curve.assign(power=[0.8, 0.9, 1.0])) == 10
    assert np.isnan(participants_needed(curve.assign(power=0.1)))
