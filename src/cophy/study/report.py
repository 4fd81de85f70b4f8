"""The rows of people in Table 1, and tables of what was answered in every study.

Files of answers under outputs/study, judged with the data that they are on.
The paper's two figures of people: where they clicked, and where objects ended, on the pictures of C; twins side by side.
"""

import json
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from cophy.errors import CophyError, check_name
from cophy.report.runs import Choices, notice
from cophy.study.answers import ANSWERS, PERSON, SIMULATED
from cophy.study.experiments import IMAGE, Scenes, image_directory
from cophy.study.judging import human_rows, judge, read_clicks, read_descriptions
from cophy.study.plan import check_resolution

log = logging.getLogger(__name__)

FILES = (ANSWERS, SIMULATED)
# what comes of a description that study.py did not write
STRANGE = (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True)
class StudyAnswers:
    """What was answered in one study.

    Attributes:
        scenario: Its name.
        split: Name of the split whose test half was shown.
        data: Id of the dataset.
        resolution: Of the pictures, pixels.
        directory: Of the study.
        judged: See `judge`.
        rows: See `human_rows`.
    """

    scenario: str
    split: str
    data: str
    resolution: int
    directory: Path
    judged: pd.DataFrame
    rows: pd.DataFrame


def read_answers(outputs: Path, choices: Choices) -> list[StudyAnswers]:
    """All studies below a folder. What cannot be read, or whose data are not there, is named and left out.

    Args:
        outputs: Studies are in its folder `study`, one folder per scenario.
        choices: Where the data are.
    """
    found = []
    for path in sorted(path for name in FILES for path in (outputs / "study").glob(f"*/{name}")):
        with _left_out(str(path)):
            for study, description in read_descriptions(path).items():
                with _left_out(f"study {study} of {path}"):
                    found += _judged(path, study, json.loads(description), choices)
    return found


@contextmanager
def _left_out(what: str) -> Iterator[None]:
    """Around the reading of something that others need not share the fate of: what is wrong with it is told."""
    try:
        yield
    except (*STRANGE, CophyError) as error:
        said = str(error) if isinstance(error, CophyError) else "no file of answers that study.py wrote"
        log.info(notice(f"{what} is left out: {said}"))


def _judged(path: Path, study: str, said: dict[str, Any], choices: Choices) -> list[StudyAnswers]:
    """One, or none where nobody answered."""
    clicks = read_clicks(path, study)
    if clicks.empty:
        return []
    for name in (said["scenario"], said["split"], *clicks["kind"].unique()):  # figures are called by them
        check_name("study", name)
    check_resolution(int(said["resolution"]))
    names = said["scenario"], int(said["num_objects"]), said["size"]
    states = choices.dataset(*names, int(said.get("data_seed", 0)), [str(each) for each in said.get("overrides", [])])
    if states.id != said["data"] or not states.is_finished():
        raise CophyError(f"its data, {said['scenario']}/{said['data']}, are not there")
    scenes = Scenes(states.spec.scenario, states.load(), int(said["resolution"]))
    judged = judge(clicks, scenes)
    keys = said["scenario"], said["split"], said["data"], int(said["resolution"])
    return [StudyAnswers(*keys, path.parent, judged, human_rows(judged))]


NUM_PAIRS = 3  # that are shown: those with the most answers
TRUTH_RADIUS = 0.04  # of the picture


def draw_studies(studies: Sequence[StudyAnswers]) -> Iterator[tuple[str, Figure]]:
    """Name and figure for every study, kind of participants and setting."""
    for number, study in enumerate(studies):
        answered = study.judged[(study.judged["practice"] == 0) & study.judged["x"].notna()]
        for (kind, setting), found in answered.groupby(["kind", "setting"]):
            who = "people" if kind == PERSON else f"simulated: {kind} (no people)"
            title = f"{study.scenario} {study.split}, {SETTING_LABELS[str(setting)]}, {who}"
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
    path = image_directory(study.directory, study.scenario, study.data, size) / f"{experiment}-{IMAGE}"
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


SETTING_LABELS = {"non_cf": "without AB", "cf": "with AB"}
CAPTION = (
    "Error of the clicks, pixels of 448 × 448: mean over answers. 1 is the lowest object of C; the mean is of these columns. "
    "σ: standard deviation over answers, of their mean error over clicked objects. By people, by pairs: 95 % interval of the mean, "
    "people or twin pairs drawn anew. The models of Table 1 are tested on all pairs."
)


def of_people(studies: Sequence[StudyAnswers], scenario: str, split: str) -> pd.DataFrame:
    """What fills the rows of people in Table 1: one line per setting and metric.

    Args:
        studies: All that were found.
        scenario: Of the table.
        split: Of the table.

    Returns:
        Columns people (the setting), metric, ours, sd, low and high (by participant). Where there are several studies, those
        of the one with the most answers.
    """
    rows = [s.rows[s.rows["kind"] == PERSON] for s in studies if (s.scenario, s.split) == (scenario, split)]
    largest = max(rows, key=lambda found: int(found["answers"].sum()), default=pd.DataFrame())
    if largest.empty:
        return pd.DataFrame(columns=["people", "metric", "ours", "sd", "low", "high"])
    metric = largest["measure"].str.replace("rank", "pixel_error").replace("mean", "pixel_error_by_height")
    found = largest.assign(people=largest["setting"], metric=metric, ours=largest["mean"], sd=largest["sigma"])
    return found.assign(low=found["low_people"], high=found["high_people"])[
        ["people", "metric", "ours", "sd", "low", "high", "participants", "answers"]
    ]


def study_tables(studies: Sequence[StudyAnswers]) -> dict[str, pd.DataFrame]:
    """Title -> what people answered, and, apart, what simulated participants did."""
    tables: dict[str, pd.DataFrame] = {}
    for study in studies:
        for are_people in (True, False):
            rows = study.rows[(study.rows["kind"] == PERSON) == are_people]
            if len(rows):
                who = "people" if are_people else "simulated participants, no people"
                title = f"Human study, {study.scenario} {study.split}: {who}"
                while title in tables:  # a study with other settings
                    title += " (another study)"
                tables[title] = _table(rows)
    return tables


def _table(rows: pd.DataFrame) -> pd.DataFrame:
    lines = {}
    for (kind, setting), found in rows.groupby(["kind", "setting"], sort=False):
        by_measure = found.set_index("measure")
        mean = by_measure.loc["mean"]
        ranks = sorted(name for name in by_measure.index if name != "mean")
        label = SETTING_LABELS[str(setting)] if kind == PERSON else f"{kind}, {SETTING_LABELS[str(setting)]}"
        lines[label] = {
            **{rank.removeprefix("rank_"): f"{by_measure['mean'][rank]:.1f}" for rank in ranks},
            "mean": f"{mean['mean']:.1f}",
            "σ": f"{mean['sigma']:.1f}",
            "by people": f"[{mean['low_people']:.1f}, {mean['high_people']:.1f}]",
            "by pairs": f"[{mean['low_pairs']:.1f}, {mean['high_pairs']:.1f}]",
            "participants": str(mean["participants"]),
            "answers": str(mean["answers"]),
            "not clicked": f"{np.round(100 * mean['missing'], 1)} %",
        }
    return pd.DataFrame(lines).T
