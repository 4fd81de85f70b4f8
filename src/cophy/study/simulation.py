"""How many people tell the two settings apart, if people were as simulated participants are.

How simulated participants answer: at random, as if nothing moved, as if AB came again, or near the truth.
Simulated participants go through the pages of a study, as a browser would, many at once.
"""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from typing import Any

import httpx
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import ttest_1samp
from starlette.applications import Starlette
from tqdm import tqdm

from cophy.errors import CophyError
from cophy.study.experiments import Scenes
from cophy.study.judging import REFERENCE_RESOLUTION
from cophy.study.server import COOKIE, OpenStudy
from cophy.study.sessions import Assignment

Pixels = dict[int, tuple[float, float]]  # slot -> x, y
# from the pictures' scenes, what is asked, and draws, to where objects end
Strategy = Callable[[Scenes, Assignment, np.random.Generator], Pixels]

# paper Table 1, of people: mean error of an answer in the setting without AB, and with it; pixels of 448
MEAN_ERROR = {"non_cf": 58.57, "cf": 54.54}
# ours: log-normal spread of the noise of an answer, which brings the standard deviation over answers near the paper's 34
SPREAD = 0.5
MEAN_OF_NORM = np.sqrt(np.pi / 2)  # of a vector of two standard normal numbers


def _at_random(scenes: Scenes, assignment: Assignment, rng: np.random.Generator) -> Pixels:
    """Anywhere in the picture."""
    size = scenes.resolution
    return {slot: (size * rng.random(), size * rng.random()) for slot in sorted(scenes.slots(assignment.experiment))}


def _stays(scenes: Scenes, assignment: Assignment, rng: np.random.Generator) -> Pixels:
    """Every object stays where it is in C."""
    return scenes.starts(assignment.experiment)


def _as_in_ab(scenes: Scenes, assignment: Assignment, rng: np.random.Generator) -> Pixels:
    """With AB, every object moves as it did there; without, it stays."""
    if assignment.setting == "cf":
        return scenes.moved_as_in_ab(assignment.experiment)
    return scenes.starts(assignment.experiment)


def _near_the_truth(scenes: Scenes, assignment: Assignment, rng: np.random.Generator) -> Pixels:
    """The truth with noise: an answer is as wrong, on average, as the paper's people are in this setting."""
    mean = MEAN_ERROR[assignment.setting] * scenes.resolution / REFERENCE_RESOLUTION
    noise = mean / MEAN_OF_NORM * rng.lognormal(-(SPREAD**2) / 2, SPREAD)  # mean of the factor: 1
    ends = scenes.ends(assignment.experiment)
    return {slot: (x + noise * rng.normal(), y + noise * rng.normal()) for slot, (x, y) in ends.items()}


STRATEGIES: Mapping[str, Strategy] = {
    "random": _at_random,
    "stays": _stays,
    "as_in_ab": _as_in_ab,
    "noisy_oracle": _near_the_truth,
}


AT_ONCE = 20  # participants
WINDOW = [800, 600]  # CSS pixels, of a browser that is none


def take_study(study: OpenStudy, app: Starlette, strategy: Strategy, *, participants: int, seed: int) -> None:
    """Let participants take the study, in this process but over its HTTP interface.

    Args:
        study: Whose participants are of a simulated kind.
        app: Its pages.
        strategy: How they answer.
        participants: How many.
        seed: Of their answers.

    Raises:
        CophyError: The pages refused one of them.
    """
    asyncio.run(_all(study, app, strategy, np.random.SeedSequence(seed).spawn(participants)))


async def _all(study: OpenStudy, app: Starlette, strategy: Strategy, seeds: list[np.random.SeedSequence]) -> None:
    free = asyncio.Semaphore(AT_ONCE)
    async with AsyncExitStack() as stack:
        # an address of each one's own: the limits are meant for people who share one
        transports = [httpx.ASGITransport(app=app, client=(f"simulated-{n}", 0)) for n in range(len(seeds))]
        browsers = [
            await stack.enter_async_context(httpx.AsyncClient(transport=each, base_url="http://study"))
            for each in transports
        ]
        for browser in browsers:  # one after the other, so that each has its place in the plan at every call
            _said(await browser.post("/api/consent", json={"agreed": True}))
        with tqdm(total=len(seeds), desc=study.sessions.kind) as bar:

            async def one(browser: httpx.AsyncClient, seed: np.random.SeedSequence) -> None:
                async with free:
                    await _visit(study, browser, strategy, np.random.default_rng(seed))
                bar.update()

            await asyncio.gather(*map(one, browsers, seeds))


async def _visit(study: OpenStudy, browser: httpx.AsyncClient, strategy: Strategy, rng: np.random.Generator) -> None:
    """From the first task to the code."""
    place = _said(await browser.get("/api/place"))
    while "code" not in place:
        for media in filter(None, (place["picture"], place["clip"])):
            _said(await browser.get(media), is_json=False)
        address = f"/api/assignments/{place['position']}"
        _said(await browser.post(f"{address}/begin", json={}))
        # what is asked; the pages do not tell the number of the experiment
        assignment = study.sessions.place(browser.cookies[COOKIE]).assignment
        assert assignment is not None
        pixels = strategy(study.experiments.scenes, assignment, rng)
        _said(await browser.post(f"{address}/answer", json=_answer(place, pixels)))
        place = _said(await browser.get("/api/place"))


def _answer(place: dict[str, Any], pixels: Pixels) -> dict[str, Any]:
    """What a browser sends; clicks beside the picture go to its edge."""
    size, at_ms = place["resolution"], round(500 * place["seconds"])
    clicks = [
        {"slot": slot, **{axis: min(max(value, 0.0), float(size)) for axis, value in zip("xy", at, strict=True)}}
        for slot, at in pixels.items()
    ]
    timed = [{**click, "at_ms": at_ms} for click in clicks]
    return {"clicks": timed, "undone": 0, "names_shown": False, "input": "none", "window": WINDOW}


def _said(response: httpx.Response, *, is_json: bool = True) -> dict[str, Any]:
    if response.status_code != httpx.codes.OK:
        raise CophyError(f"the study refused a simulated participant: {response.status_code} {response.text[:200]}")
    return dict(response.json()) if is_json else {}


NUM_PEOPLE = (5, 10, 20, 30, 50, 75, 100, 150, 200, 300)
NUM_STUDIES = 2000  # that are drawn for each number of people
SIGNIFICANCE = 0.05
WANTED = 0.8  # the power that is asked of a study by custom


def differences(judged: pd.DataFrame) -> np.ndarray:
    """(participant,) how much smaller a participant's mean error is with AB than without, pixels of 448.

    Args:
        judged: Clicks of one kind of participants, see `judge`.
    """
    answers = judged[judged["practice"] == 0].groupby(["participant", "setting", "experiment"])["error"].mean()
    means = answers.groupby(level=["participant", "setting"]).mean().unstack("setting")
    return (means["non_cf"] - means["cf"]).dropna().to_numpy()


def power_curve(difference: np.ndarray, seed: int) -> pd.DataFrame:
    """Share of studies of n people in which a paired t-test (two-sided, 5 %) finds that AB helps.

    Args:
        difference: See `differences`; people are drawn from these with replacement.
        seed: Of the draws.

    Returns:
        Columns people and power.
    """
    rng, lines = np.random.default_rng(seed), []
    for people in NUM_PEOPLE:
        drawn = difference[rng.integers(len(difference), size=(NUM_STUDIES, people))]
        test = ttest_1samp(drawn, 0.0, axis=1)
        found = (np.asarray(test.pvalue) < SIGNIFICANCE) & (drawn.mean(axis=1) > 0)
        lines.append({"people": people, "power": float(found.mean())})
    return pd.DataFrame(lines)


def people_needed(curve: pd.DataFrame) -> float:
    """Where the curve crosses 80 %, between its points in a straight line; NaN where it never does."""
    above = curve["power"] >= WANTED
    if not above.any():
        return float("nan")
    last = int(np.argmax(above.to_numpy()))
    if last == 0:
        return float(curve["people"].iloc[0])
    part = curve.iloc[last - 1 : last + 1]
    return float(np.interp(WANTED, part["power"], part["people"]))


def draw_power(curve: pd.DataFrame, difference: np.ndarray, title: str) -> Figure:
    """The curve as a figure.

    Args:
        curve: See `power_curve`.
        difference: See `differences`.
        title: Of the figure.
    """
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.plot(curve["people"], curve["power"], marker="o")
    axis.axhline(WANTED, color="0.6", linestyle="--", linewidth=1)
    axis.set(xlabel="people", ylabel="studies that find the difference", ylim=(0, 1.02), xlim=(0, None))
    axis.yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axis.grid(alpha=0.2)
    said = f"AB helps by {difference.mean():.1f} ± {difference.std(ddof=1):.1f} pixels (mean ± SD over participants)"
    axis.set_title(f"{title}\n{said}", fontsize="medium")
    return figure
