"""The human study of Table 1: python src/study.py scenario=blocktower"""

import importlib.util
import logging
from pathlib import Path

import hydra
from omegaconf import DictConfig

from cophy.app import cli
from cophy.app.composition import CONF, to_config
from cophy.app.datasets import generated_by
from cophy.app.schemas.registration import register
from cophy.app.schemas.study_command import StudyConfig
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
    _serve(settings, states)


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


def run() -> None:
    """The command, as `pip install` puts it on the PATH."""
    cli.run(main)
