"""Human participants in the report: their rows in Table 1, tables of every study, and figures of their clicks."""

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from cophy.dataset.states import States, sort_by_twins
from cophy.errors import CophyError, check_name
from cophy.report.render import Cell, TextTable
from cophy.report.runs import MISSING, notice
from cophy.study.answers import ANSWERS, PERSON, SIMULATED
from cophy.study.experiments import IMAGE, Scenes, image_directory
from cophy.study.judging import human_rows, judge, read_clicks, read_descriptions
from cophy.study.plan import check_resolution

log = logging.getLogger(__name__)

Dataset = Callable[[str, int, str, int, Sequence[str]], States]  # scenario, num_objects, size, data_seed, overrides


@dataclass(frozen=True)
class StudyAnswers:
    """The answers of one study.

    Attributes:
        scenario: Name of the scenario.
        split: Name of the split whose test half was shown.
        data: Id of the dataset.
        resolution: Resolution of the images, pixels.
        directory: Folder of the study.
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


def read_answers(outputs: Path, dataset: Dataset) -> list[StudyAnswers]:
    """Return all studies below a folder; what cannot be read, or whose data do not exist, is named and left out."""
    studies = []
    for path in sorted(path for name in (ANSWERS, SIMULATED) for path in (outputs / "study").glob(f"*/{name}")):
        with _left_out(str(path)):
            for study, description in read_descriptions(path).items():
                with _left_out(f"study {study} of {path}"):
                    studies += _judge(path, study, description, dataset)
    return studies


@contextmanager
def _left_out(name: str) -> Iterator[None]:
    """Log why a file or study cannot be read, and continue with the others."""
    try:
        yield
    except CophyError as error:
        log.info(notice(f"{name} is left out: {error}"))


def _judge(path: Path, study: str, description: str, dataset: Dataset) -> list[StudyAnswers]:
    """Return the judged answers of a study; none where there are no clicks."""
    clicks = read_clicks(path, study)
    if clicks.empty:
        return []
    try:
        values = json.loads(description)
        scenario, split, resolution = values["scenario"], values["split"], int(values["resolution"])
        size, data, overrides = str(values["size"]), values["data"], [str(each) for each in values.get("overrides", [])]
        for name in (scenario, split, size, *clicks["kind"].unique()):  # of files
            check_name("study", name)
        check_resolution(resolution)
        num_objects, data_seed = int(values["num_objects"]), int(values.get("data_seed", 0))
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise CophyError(f"its description was not written by study.py ({type(error).__name__}: {error})") from error
    states = dataset(scenario, num_objects, size, data_seed, overrides)
    if states.id != data or not states.is_finished():
        remedy = f": run `{states.command}`" if states.id == data else ""
        raise CophyError(f"its data, {scenario}/{data}, are not there{remedy}")
    judged = judge(clicks, Scenes(states.spec.scenario, sort_by_twins(states.load(), states.spec), resolution))
    return [StudyAnswers(scenario, split, states.id, resolution, path.parent, judged, human_rows(judged))]


NUM_PAIRS = 3  # drawn: those with the most answers
TRUTH_RADIUS = 0.04  # part of the image


def draw_studies(studies: Sequence[StudyAnswers]) -> dict[str, Figure]:
    """Return name -> figure for every study, kind of participants and setting."""
    figures: dict[str, Figure] = {}
    for study in studies:
        answered = study.judged[(study.judged["practice"] == 0) & study.judged["x"].notna()]
        for (kind, setting), clicks in answered.groupby(["kind", "setting"]):
            who = "human participants" if kind == PERSON else f"simulated participants: {kind}"
            title = f"{study.scenario} {study.split}, {SETTING_LABELS[str(setting)]}, {who}"
            name = f"study-{study.scenario}-{study.split}-{kind}-{setting}"
            number = sum(other.startswith(name) for other in figures)
            figures[f"{name}-{number + 1}" if number else name] = _draw(study, clicks, title)
    return figures


def _draw(study: StudyAnswers, clicks: pd.DataFrame, title: str) -> Figure:
    """Draw twin pairs below each other, twins next to each other."""
    pairs = (clicks["experiment"] // 2).value_counts().sort_index().sort_values(ascending=False, kind="stable")
    drawn_pairs = sorted(pairs.index[:NUM_PAIRS].tolist())
    figure = Figure(figsize=(6.4, 0.8 + 3.3 * len(drawn_pairs)), layout="constrained")
    axes = figure.subplots(len(drawn_pairs), 2, squeeze=False)
    for pair, row in zip(drawn_pairs, axes, strict=True):
        for twin, axis in enumerate(row):
            experiment = 2 * pair + twin
            _draw_experiment(axis, study, experiment, clicks[clicks["experiment"] == experiment])
            axis.set_title(f"twin pair {pair}, twin {twin + 1}", fontsize="small")
    figure.suptitle(f"{title}\nC; small dots: clicks; circles: where objects end", fontsize="medium")
    return figure


def _draw_experiment(axis: Axes, study: StudyAnswers, experiment: int, clicks: pd.DataFrame) -> None:
    size = study.resolution
    path = image_directory(study.directory, study.scenario, study.data, size) / f"{experiment}-{IMAGE}"
    image = cv2.imread(str(path)) if path.exists() else None
    if image is None:
        log.info(notice(f"{path} does not exist: its figure has no image of C. study.py draws it."))
        image = np.full((size, size, 3), 235, np.uint8)
    axis.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), extent=(0, size, size, 0))
    for color, group in clicks.groupby("color"):
        axis.scatter(group["x"], group["y"], s=14, color=color, edgecolor="white", linewidth=0.5, zorder=3)
    for end in clicks.drop_duplicates("slot")[["true_x", "true_y", "color"]].to_dict("records"):
        for width, line in ((3.4, "white"), (1.8, end["color"])):
            circle = axis.add_patch(Circle((end["true_x"], end["true_y"]), TRUTH_RADIUS * size))
            circle.set(fill=False, edgecolor=line, linewidth=width, zorder=2)
    axis.set(xlim=(0, size), ylim=(size, 0), xticks=[], yticks=[])


SETTING_LABELS = {"non_cf": "without AB", "cf": "with AB"}
CAPTION = (
    "Error of the clicks, pixels of 448 × 448: mean over answers. 1 is the lowest object of C; the mean is of these columns. "
    "σ: standard deviation over answers, of their mean error over clicked objects. By participants, by pairs: 95 % bootstrap "
    "interval of the mean over participants or twin pairs. The models of Table 1 are tested on all pairs."
)


def table_numbers(studies: Sequence[StudyAnswers]) -> pd.DataFrame:
    """Return the numbers of human participants for the paper's tables, one line per scenario, split, setting and metric.

    Of several studies on one split, the one with the most answers counts. low and high: over participants.
    """
    largest: dict[tuple[str, str], pd.DataFrame] = {}
    for study in studies:
        rows, place = study.rows[study.rows["kind"] == PERSON], (study.scenario, study.split)
        if len(rows) and (place not in largest or rows["answers"].sum() > largest[place]["answers"].sum()):
            metric = rows["measure"].str.replace("rank", "pixel_error").replace("mean", "pixel_error_by_height")
            largest[place] = rows.assign(scenario=study.scenario, split=study.split, metric=metric)
    names = {"mean": "ours", "sigma": "sd", "low_people": "low", "high_people": "high"}
    return pd.concat([pd.DataFrame(), *largest.values()]).rename(columns=names)


def study_tables(studies: Sequence[StudyAnswers]) -> list[TextTable]:
    """Return tables of the answers of human participants, and separately of simulated ones."""
    tables: list[TextTable] = []
    for study in studies:
        for are_human in (True, False):
            rows = study.rows[(study.rows["kind"] == PERSON) == are_human]
            if len(rows):
                who = "human participants" if are_human else "simulated participants"
                title = f"Human study, {study.scenario} {study.split}: {who}"
                while title in [table.title for table in tables]:  # a study with other settings
                    title += " (another study)"
                tables.append(TextTable(f"study-{len(tables)}", title, _table(rows).fillna(MISSING).map(Cell), CAPTION))
    return tables


def _table(rows: pd.DataFrame) -> pd.DataFrame:
    lines = {}
    for (kind, setting), group in rows.groupby(["kind", "setting"], sort=False):
        by_measure = group.set_index("measure")
        mean = by_measure.loc["mean"]
        ranks = sorted(name for name in by_measure.index if name != "mean")
        label = SETTING_LABELS[str(setting)] if kind == PERSON else f"{kind}, {SETTING_LABELS[str(setting)]}"
        lines[label] = {
            **{rank.removeprefix("rank_"): f"{by_measure['mean'][rank]:.1f}" for rank in ranks},
            "mean": f"{mean['mean']:.1f}",
            "σ": f"{mean['sigma']:.1f}",
            "by participants": f"[{mean['low_people']:.1f}, {mean['high_people']:.1f}]",
            "by pairs": f"[{mean['low_pairs']:.1f}, {mean['high_pairs']:.1f}]",
            "participants": str(mean["participants"]),
            "answers": str(mean["answers"]),
            "not clicked": f"{np.round(100 * mean['missing'], 1)} %",
        }
    return pd.DataFrame(lines).T
