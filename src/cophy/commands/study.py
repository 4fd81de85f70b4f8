"""The human study of Table 1: python src/study.py scenario=blocktower"""

import importlib.util
import logging
import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy.app import cli
from cophy.app.composition import CONF, to_config
from cophy.app.datasets import generated_by
from cophy.app.schemas.registration import register
from cophy.app.schemas.study_command import ACTIONS, StudyConfig
from cophy.atomic_files import write_atomically
from cophy.dataset import generation
from cophy.dataset.store.states import States
from cophy.errors import CophyError

register()
log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="study")
def main(cfg: DictConfig) -> None:
    if any(importlib.util.find_spec(name) is None for name in ("markdown_it", "starlette", "uvicorn")):
        raise CophyError("the study needs packages: pip install -e '.[study]'")
    settings = to_config(cfg, StudyConfig)
    states = _data(settings)
    generation.ensure(states, workers=settings.workers)
    {"serve": _serve, "export": _export}[settings.action](settings, states)


def _data(settings: StudyConfig) -> States:
    """The dataset with the number of objects that the split tests."""
    shown = settings.num_objects or [settings.split.test.num_objects]
    if len(shown) != 1:
        raise CophyError(f"num_objects={shown}: a study is on one number of objects")
    settings.num_objects = shown
    return generated_by(settings)[0]


def _serve(settings: StudyConfig, states: States) -> None:
    """Until it is interrupted."""
    from cophy.study.answer_store import PERSON, AnswerStore
    from cophy.study.pages.serving import open_study, serve

    directory = Path(settings.directory)
    store = AnswerStore(directory / "answers.sqlite")
    study = open_study(store, states, settings.split, settings.study, directory, kind=PERSON, workers=settings.workers)
    log.info("study %s on http://%s:%d/; answers: %s", study.sessions.study, settings.host, settings.port, directory)
    welcome = None if settings.welcome is None else Path(settings.welcome)
    app = study.app(welcome, settings.limits)
    serve(app, settings.host, settings.port, settings.trusted_proxies)
    store.close()


def _export(settings: StudyConfig, states: States) -> None:
    """answers.csv with a line per object of every answer; table.csv with the rows of Table 1."""
    from cophy.study.experiments import StudyExperiments
    from cophy.study.judging import human_rows, judge, read_clicks

    directory = Path(settings.directory)
    path = directory / "answers.sqlite"
    if not path.exists():
        raise CophyError(f"{path} does not exist: nobody took this study yet")
    experiments = StudyExperiments(states, settings.split, settings.study)
    judged = judge(read_clicks(path, experiments.study_id), experiments)
    rows = human_rows(judged)
    for name, table in (("answers.csv", judged), ("table.csv", rows)):
        write_atomically(directory / name, table.to_csv(index=False).encode())
    log.info(
        "%s\n%d clicks in answers.csv, these rows in table.csv: %s", rows.round(2).to_string(), len(judged), directory
    )


def run() -> None:
    """The command, as `pip install` puts it on the PATH. Its first word may be an action: study.py export."""
    if sys.argv[1:2] and sys.argv[1] in ACTIONS:
        sys.argv[1] = f"action={sys.argv[1]}"
    cli.run(main)
