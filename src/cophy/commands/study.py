"""The human study of Table 1: python src/study.py scenario=blocktower"""

import importlib.util
import io
import logging
import math
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from omegaconf import DictConfig

from cophy import cli
from cophy.atomic_files import appearing_whole, read_plain, write_atomically
from cophy.config import CONF, generated_by, to_config
from cophy.dataset import generation
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.schemas import ACTIONS, StudyConfig, register
from cophy.study.answers import ANSWERS, SIMULATED

if TYPE_CHECKING:
    import pandas as pd

LIKE_PEOPLE = "noisy_oracle"  # the simulated participants that the power is of
register()
log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="study")
@cli.in_one_line
def main(cfg: DictConfig) -> None:
    if any(importlib.util.find_spec(name) is None for name in ("httpx", "markdown_it", "starlette", "uvicorn")):
        raise CophyError("the study needs packages: pip install -e '.[study]'")
    settings = to_config(cfg, StudyConfig)
    states = _data(settings)
    generation.ensure(states, workers=settings.workers)
    actions = {"serve": _serve, "export": _export, "simulate": _simulate, "power": _power}
    actions[settings.action](settings, states)


def _data(settings: StudyConfig) -> States:
    """The dataset with the number of objects that the split tests."""
    shown = settings.num_objects or [settings.split.test.num_objects]
    if len(shown) != 1:
        raise CophyError(f"num_objects={shown}: a study is on one number of objects")
    settings.num_objects = shown
    return generated_by(settings)[0]


def _serve(settings: StudyConfig, states: States) -> None:
    """Until it is interrupted."""
    from cophy.study.answers import PERSON, AnswerStore
    from cophy.study.server import alone, listening, open_study, serve

    directory, welcome = Path(settings.directory), _welcome(settings)
    with listening(settings.host, settings.port) as listener, alone(directory / ANSWERS):
        store = AnswerStore(directory / ANSWERS)
        chosen = settings.split, settings.study, directory
        study = open_study(store, states, *chosen, kind=PERSON, workers=settings.workers)
        app = study.app(welcome, settings.limits)
        host, port, *_ = listener.getsockname()
        log.info("study %s on http://%s:%d/; answers: %s", study.sessions.study, host, port, directory)
        serve(app, listener, settings.trusted_proxies)
        store.close()


def _export(settings: StudyConfig, states: States) -> None:
    """answers.csv with a line per object of every answer, participants.csv, and table.csv with the rows of Table 1."""
    from cophy.study.judging import human_rows

    path = Path(settings.directory) / ANSWERS
    if not path.exists():
        raise CophyError(f"{path} does not exist: nobody took this study yet")
    people, judged = _judged(path, settings, states)
    rows = human_rows(judged)
    for name, table in (("answers.csv", judged), ("participants.csv", people), ("table.csv", rows)):
        write_atomically(path.with_name(name), table.to_csv(index=False).encode())
    said = (
        "%s\n%d clicks in answers.csv, %d participants and their codes in participants.csv, these rows in table.csv: %s"
    )
    told = "no answers but of practice yet" if rows.empty else rows.round(2).to_string()
    log.info(said, told, len(judged), len(people), path.parent)


def _simulate(settings: StudyConfig, states: States) -> None:
    """Simulated participants take the study; their answers have a file of their own, which is made anew.

    The one before is there until the new one is whole.
    """
    from cophy.study.answers import AnswerStore, naming, remove_journal
    from cophy.study.judging import human_rows
    from cophy.study.server import alone, open_study
    from cophy.study.simulation import STRATEGIES, take_study

    logging.getLogger("httpx").setLevel(logging.WARNING)  # says every request otherwise
    directory, welcome = Path(settings.directory), _welcome(settings)
    path, chosen = directory / SIMULATED, (settings.split, settings.study, directory)
    first, *_ = STRATEGIES
    with alone(path), naming(path), appearing_whole(path) as new:
        with closing(AnswerStore(new)) as store:
            study = open_study(store, states, *chosen, kind=first, workers=settings.workers)
            for number, (kind, strategy) in enumerate(STRATEGIES.items()):
                of_kind = replace(study, sessions=study.sessions.of_kind(kind))
                app = of_kind.app(welcome, settings.limits)
                seed = len(STRATEGIES) * settings.study.seed + number
                take_study(of_kind, app, strategy, participants=settings.participants, seed=seed)
        remove_journal(path)
    _, judged = _judged(path, settings, states)
    log.info("%s\nanswers: %s", human_rows(judged).round(2).to_string(), path)


def _power(settings: StudyConfig, states: States) -> None:
    """power.csv and power.png, from the simulated participants that are as wrong as the paper's people."""
    from cophy.study.simulation import differences, draw_power, people_needed, power_curve

    path = Path(settings.directory) / SIMULATED
    if not path.exists():
        raise CophyError(f"{path} does not exist; it is made by: study.py simulate scenario={settings.scenario.name}")
    _, judged = _judged(path, settings, states)
    difference = differences(judged[judged["kind"] == LIKE_PEOPLE])
    if len(difference) < 2:
        raise CophyError(f"{path}: simulated participants of this study are missing; study.py simulate makes them")
    curve = power_curve(difference, settings.study.seed)
    title = f"{settings.scenario.name} {settings.split.name}: {LIKE_PEOPLE}, {len(difference)} simulated participants"
    picture = io.BytesIO()
    draw_power(curve, difference, title).savefig(picture, format="png", dpi=110)
    write_atomically(path.with_name("power.csv"), curve.to_csv(index=False).encode())
    write_atomically(path.with_name("power.png"), picture.getvalue())
    needed, most = people_needed(curve), curve["people"].max()
    people = f"more than {most}" if math.isnan(needed) else f"about {needed:.0f}"
    said = "%s\n80 %% of studies find the difference with %s people. power.csv, power.png: %s"
    log.info(said, curve.to_string(index=False), people, path.parent)


def _judged(path: Path, settings: StudyConfig, states: States) -> "tuple[pd.DataFrame, pd.DataFrame]":
    """The participants of this study in a file of answers, and their clicks."""
    from cophy.study.experiments import StudyExperiments
    from cophy.study.judging import judge, read_clicks, read_participants

    experiments = StudyExperiments(states, settings.split, settings.study)
    people = read_participants(path, experiments.study_id)
    return people, judge(read_clicks(path, experiments.study_id), experiments.scenes)


def _welcome(settings: StudyConfig) -> str | None:
    if settings.welcome is None:
        return None
    try:
        return read_plain(Path(settings.welcome)).decode()
    except UnicodeDecodeError as error:
        raise CophyError(f"welcome={settings.welcome} is no text: save it as UTF-8 ({error.reason})") from None


def run() -> None:
    """The command, as `pip install` puts it on the PATH. Its first word may be an action: study.py export."""
    if sys.argv[1:2] and sys.argv[1] in ACTIONS:
        sys.argv[1] = f"action={sys.argv[1]}"
    cli.run(main)
