"""Files of answers under outputs/study, judged with the data that they are on."""

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from cophy.errors import CophyError, check_name
from cophy.report.choices import Choices
from cophy.report.tables.terminal_tables import notice
from cophy.study.answer_tables import ANSWERS, SIMULATED
from cophy.study.results.answer_file import read_clicks, read_descriptions
from cophy.study.results.judging import human_rows, judge
from cophy.study.scenes import Scenes
from cophy.study.study_settings import check_resolution

FILES = (ANSWERS, SIMULATED)
# what comes of a description that study.py did not write
STRANGE = (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError)
log = logging.getLogger(__name__)


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
