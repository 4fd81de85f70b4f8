"""The paper's two figures of people: where they clicked, and where objects ended, on the pictures of C; twins side by side."""

import logging
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from cophy.report.people.study_answers import StudyAnswers
from cophy.report.people.study_tables import SETTINGS
from cophy.report.tables.terminal_tables import notice
from cophy.study.answer_store import PERSON
from cophy.study.pages.browser_clips import PICTURE, pictures_of

NUM_PAIRS = 3  # that are shown: those with the most answers
TRUTH_RADIUS = 0.04  # of the picture
log = logging.getLogger(__name__)


def draw_studies(studies: Sequence[StudyAnswers]) -> Iterator[tuple[str, Figure]]:
    """Name and figure for every study, kind of participants and setting."""
    for number, study in enumerate(studies):
        answered = study.judged[(study.judged["practice"] == 0) & study.judged["x"].notna()]
        for (kind, setting), found in answered.groupby(["kind", "setting"]):
            who = "people" if kind == PERSON else f"simulated: {kind} (no people)"
            title = f"{study.scenario} {study.split}, {SETTINGS[str(setting)]}, {who}"
            same = [s for s in studies[:number] if (s.scenario, s.split, s.directory) == _place(study)]
            again = f"-{len(same) + 1}" if any(kind in set(s.judged["kind"]) for s in same) else ""
            name = f"study-{study.scenario}-{study.split}-{kind}-{setting}{again}"
            yield name, _draw(study, found, title)


def _place(study: StudyAnswers) -> tuple[object, ...]:
    return study.scenario, study.split, study.directory


def _draw(study: StudyAnswers, clicks: pd.DataFrame, title: str) -> Figure:
    """Twin pairs below each other, twins side by side."""
    pairs = (clicks["experiment"] // 2).value_counts().sort_index().sort_values(ascending=False, kind="stable")
    shown = sorted(pairs.index[:NUM_PAIRS].tolist())
    figure = Figure(figsize=(6.4, 0.8 + 3.3 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), 2, squeeze=False)
    for pair, row in zip(shown, axes, strict=True):
        for twin, axis in enumerate(row):
            experiment = 2 * pair + twin
            _draw_experiment(axis, study, experiment, clicks[clicks["experiment"] == experiment])
            axis.set_title(f"twin pair {pair}, twin {twin + 1}", fontsize="small")
    figure.suptitle(f"{title}\nC; small dots: clicks; circles: where objects end", fontsize="medium")
    return figure


def _draw_experiment(axis: Axes, study: StudyAnswers, experiment: int, clicks: pd.DataFrame) -> None:
    size = study.resolution
    path = pictures_of(study.directory, study.scenario, study.data, size) / f"{experiment}-{PICTURE}"
    picture = cv2.imread(str(path)) if path.exists() else None
    if picture is None:
        log.info(notice(f"{path} is not there: its figure has no picture of C. study.py draws it."))
        picture = np.full((size, size, 3), 235, np.uint8)
    axis.imshow(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), extent=(0, size, size, 0))
    for color, found in clicks.groupby("color"):
        axis.scatter(found["x"], found["y"], s=14, color=color, edgecolor="white", linewidth=0.5, zorder=3)
    for end in clicks.drop_duplicates("slot")[["true_x", "true_y", "color"]].to_dict("records"):
        for width, line in ((3.4, "white"), (1.8, end["color"])):
            circle = axis.add_patch(Circle((end["true_x"], end["true_y"]), TRUTH_RADIUS * size))
            circle.set(fill=False, edgecolor=line, linewidth=width, zorder=2)
    axis.set(xlim=(0, size), ylim=(size, 0), xticks=[], yticks=[])
