"""Simulated participants, and the number of human participants that a study needs if they answer like these."""

import io
import logging
import math
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import ttest_1samp
from tqdm import tqdm

from cophy.atomic_files import appearing_whole, write_atomically
from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.study.answers import SIMULATED, AnswerStore, exclusive, naming_file
from cophy.study.experiments import Positions, Scenes, StudyExperiments
from cophy.study.judging import REFERENCE_RESOLUTION, human_rows, read_judged
from cophy.study.plan import StudySettings, StudyTask
from cophy.study.sessions import Sessions

log = logging.getLogger(__name__)

# returns where objects end, according to a simulated participant
Strategy = Callable[[Scenes, StudyTask, np.random.Generator], Positions]

# paper Table 1, human participants: mean error of an answer without and with AB, pixels of 448
MEAN_ERROR = {"non_cf": 58.57, "cf": 54.54}
# ours: log-normal spread of an answer's noise; the standard deviation over answers is then near the paper's 34
SPREAD = 0.5
MEAN_OF_NORM = np.sqrt(np.pi / 2)  # of a vector of two standard normal numbers
WINDOW_PX = [800, 600]  # window that is stored for simulated participants, CSS pixels


def _click_at_random(scenes: Scenes, task: StudyTask, rng: np.random.Generator) -> Positions:
    """Click anywhere in the image."""
    size = scenes.resolution
    return {slot: (size * rng.random(), size * rng.random()) for slot in sorted(scenes.slots(task.experiment))}


def _click_as_in_ab(scenes: Scenes, task: StudyTask, rng: np.random.Generator) -> Positions:
    """With AB, move every object as in AB; without AB, click where it is in C."""
    return scenes.moved_as_in_ab(task.experiment) if task.setting == "cf" else scenes.starts(task.experiment)


def _click_near_ends(scenes: Scenes, task: StudyTask, rng: np.random.Generator) -> Positions:
    """Click at the true ends with noise, whose mean is the error of the paper's participants in this setting."""
    mean = MEAN_ERROR[task.setting] * scenes.resolution / REFERENCE_RESOLUTION
    noise = mean / MEAN_OF_NORM * rng.lognormal(-(SPREAD**2) / 2, SPREAD)  # the factor has a mean of 1
    ends = scenes.ends(task.experiment)
    return {slot: (x + noise * rng.normal(), y + noise * rng.normal()) for slot, (x, y) in ends.items()}


HUMAN_LIKE = "noisy_oracle"  # the power is computed for participants of this kind
STRATEGIES: Mapping[str, Strategy] = {
    "random": _click_at_random,
    "stays": lambda scenes, task, rng: scenes.starts(task.experiment),
    "as_in_ab": _click_as_in_ab,
    HUMAN_LIKE: _click_near_ends,
}


def simulate(experiments: StudyExperiments, *, participants: int, workers: int) -> None:
    """Let simulated participants of every kind take the study, and write their answers to a new file.

    The previous file is replaced only when the new one is complete.

    Args:
        participants: Number of each kind.
    """
    path = experiments.directory / SIMULATED
    with exclusive(path), naming_file(path), appearing_whole(path) as temporary:
        experiments.draw_missing(workers=workers)
        with closing(AnswerStore(temporary)) as store:
            for number, kind in enumerate(STRATEGIES):
                seed = len(STRATEGIES) * experiments.settings.seed + number
                take_study(Sessions(store, experiments, kind), participants, seed)
        for suffix in ("-wal", "-shm"):  # SQLite would apply the journal of the old file to the new one
            path.with_name(f"{path.name}{suffix}").unlink(missing_ok=True)
    _, judged = read_judged(path, experiments.states, experiments.split, experiments.settings)
    log.info("%s\nanswers: %s", human_rows(judged).round(2).to_string(), path)


def take_study(sessions: Sessions, participants: int, seed: int) -> None:
    """Store the answers of simulated participants, one participant after the other.

    Args:
        participants: Their number.
    """
    scenes, strategy = sessions.experiments.scenes, STRATEGIES[sessions.kind]
    for participant_seed in tqdm(np.random.SeedSequence(seed).spawn(participants), desc=sessions.kind):
        rng, token = np.random.default_rng(participant_seed), sessions.consent(None)
        place = sessions.place(token)
        while place.task is not None:
            sessions.begin(token, place.position)
            sessions.answer(token, place.position, _answer(strategy(scenes, place.task, rng), sessions))
            place = sessions.place(token)


def _answer(positions: Positions, sessions: Sessions) -> dict[str, object]:
    """Return what a browser would send; clicks outside the image move to its edge."""
    size, at_ms = sessions.settings.resolution, round(500 * sessions.settings.seconds)
    clicks = [
        {"slot": slot, "x": min(max(x, 0.0), float(size)), "y": min(max(y, 0.0), float(size)), "at_ms": at_ms}
        for slot, (x, y) in positions.items()
    ]
    return {"clicks": clicks, "undone": 0, "names_shown": False, "input": "none", "window": WINDOW_PX}


NUM_PARTICIPANTS = (5, 10, 20, 30, 50, 75, 100, 150, 200, 300)
NUM_STUDIES = 2000  # that are drawn for each number of participants
SIGNIFICANCE = 0.05
TARGET_POWER = 0.8  # customary


def estimate_power(states: States, split: Split, settings: StudySettings, directory: Path) -> None:
    """Write power.csv and power.png, computed from the simulated participants that err like the paper's."""
    path, scenario = directory / SIMULATED, states.spec.scenario.name
    if not path.exists():
        raise CophyError(f"{path} does not exist: run study.py simulate scenario={scenario} first")
    _, judged = read_judged(path, states, split, settings)
    differences = error_differences(judged[judged["kind"] == HUMAN_LIKE])
    if len(differences) < 2:
        raise CophyError(f"{path} has no simulated participants of this study: run study.py simulate first")
    curve = power_curve(differences, settings.seed)
    title = f"{scenario} {split.name}: {HUMAN_LIKE}, {len(differences)} simulated participants"
    image = io.BytesIO()
    draw_power(curve, differences, title).savefig(image, format="png", dpi=110)
    write_atomically(path.with_name("power.csv"), curve.to_csv(index=False).encode())
    write_atomically(path.with_name("power.png"), image.getvalue())
    needed = participants_needed(curve)
    number = f"more than {NUM_PARTICIPANTS[-1]}" if math.isnan(needed) else f"about {needed:.0f}"
    message = "%s\nA power of 80 %% needs %s participants. power.csv, power.png: %s"
    log.info(message, curve.to_string(index=False), number, path.parent)


def error_differences(judged: pd.DataFrame) -> np.ndarray:
    """Return (participant,) mean error without AB minus mean error with AB, pixels of 448.

    Args:
        judged: Clicks of one kind of participants, see `judge`.
    """
    answers = judged[judged["practice"] == 0].groupby(["participant", "setting", "experiment"])["error"].mean()
    means = answers.groupby(level=["participant", "setting"]).mean().unstack("setting")
    return (means["non_cf"] - means["cf"]).dropna().to_numpy()


def power_curve(differences: np.ndarray, seed: int) -> pd.DataFrame:
    """Return the share of studies in which a paired t-test (two-sided, 5 %) finds that AB helps.

    Args:
        differences: See `error_differences`; participants of a study are drawn from them with replacement.

    Returns:
        Columns people (number of participants) and power.
    """
    rng, rows = np.random.default_rng(seed), []
    for participants in NUM_PARTICIPANTS:
        drawn = differences[rng.integers(len(differences), size=(NUM_STUDIES, participants))]
        test = ttest_1samp(drawn, 0.0, axis=1)
        is_significant = (np.asarray(test.pvalue) < SIGNIFICANCE) & (drawn.mean(axis=1) > 0)
        rows.append({"people": participants, "power": float(is_significant.mean())})
    return pd.DataFrame(rows)


def participants_needed(curve: pd.DataFrame) -> float:
    """Return where the curve reaches a power of 80 %, interpolated linearly; NaN if it never does."""
    reached = np.flatnonzero(curve["power"] >= TARGET_POWER)
    if len(reached) == 0:
        return float("nan")
    part = curve.iloc[max(reached[0] - 1, 0) : reached[0] + 1]
    return float(np.interp(TARGET_POWER, part["power"], part["people"]))


def draw_power(curve: pd.DataFrame, differences: np.ndarray, title: str) -> Figure:
    """Draw the power over the number of participants.

    Args:
        curve: See `power_curve`.
        differences: See `error_differences`.
    """
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.plot(curve["people"], curve["power"], marker="o")
    axis.axhline(TARGET_POWER, color="0.6", linestyle="--", linewidth=1)
    axis.set(xlabel="participants", ylabel="studies that find the difference", ylim=(0, 1.02), xlim=(0, None))
    axis.yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axis.grid(alpha=0.2)
    effect = f"AB helps by {differences.mean():.1f} ± {differences.std(ddof=1):.1f} pixels"
    axis.set_title(f"{title}\n{effect} (mean ± SD over participants)", fontsize="medium")
    return figure
