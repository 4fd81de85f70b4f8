"""The human study of Table 1: python src/study.py scenario=blocktower"""

import importlib.util
import logging
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

from cophy import cli
from cophy.config import generated_by, to_config
from cophy.dataset import generation
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.schemas import ACTIONS, StudyConfig

if TYPE_CHECKING:
    from cophy.study.experiments import StudyExperiments

log = logging.getLogger(__name__)


@cli.command("study")
def run_study(cfg: DictConfig) -> None:
    config = to_config(cfg, StudyConfig)
    num_objects = config.num_objects or [config.split.test.num_objects]
    if len(num_objects) != 1:
        raise CophyError(f"num_objects={num_objects}: a study shows experiments with one number of objects")
    if config.action == "serve" and not all(map(importlib.util.find_spec, ("markdown_it", "starlette", "uvicorn"))):
        raise CophyError("the study needs more packages: pip install 'cophy[study]'")
    (states,) = generated_by(replace(config, num_objects=num_objects))
    _run_action(config, states)


def _run_action(config: StudyConfig, states: States) -> None:
    """Run one action; imports are here so that --help is quick, and serving alone needs the packages of `study`."""
    settings = states, config.split, config.study, Path(config.directory)
    if config.action == "export":
        from cophy.study.judging import export_answers

        export_answers(*settings)
    elif config.action == "power":
        from cophy.study.simulation import estimate_power

        estimate_power(*settings)
    else:
        from cophy.study.experiments import StudyExperiments
        from cophy.study.simulation import simulate

        generation.ensure(states, workers=config.workers)
        experiments = StudyExperiments(*settings)
        if config.action == "serve":
            _serve(config, experiments)
        else:
            simulate(experiments, participants=config.participants, workers=config.workers)


def _serve(config: StudyConfig, experiments: "StudyExperiments") -> None:
    """Serve the study until it is interrupted."""
    from cophy.study.answers import ANSWERS, PERSON, AnswerStore, exclusive
    from cophy.study.server import listen, make_app, serve, welcome_text
    from cophy.study.sessions import Sessions

    welcome, path = welcome_text(config.welcome, config.study), experiments.directory / ANSWERS
    with listen(config.host, config.port) as listener, exclusive(path), closing(AnswerStore(path)) as store:
        experiments.draw_missing(workers=config.workers)
        address, port, *_ = listener.getsockname()
        log.info("study %s on http://%s:%d/; answers: %s", experiments.study_id, address, port, path.parent)
        hosts = (config.host, *config.allowed_hosts)
        app = make_app(Sessions(store, experiments, PERSON), welcome, config.limits, hosts)
        serve(app, listener, config.trusted_proxies)


def main() -> None:
    """Run the command. Its first word may be an action: study.py export."""
    if sys.argv[1:2] and sys.argv[1] in ACTIONS:
        sys.argv[1] = f"action={sys.argv[1]}"
    run_study()
