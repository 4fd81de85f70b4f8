"""The human study of Table 1: python src/study.py scenario=blocktower"""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig

from cophy import cli
from cophy.config import generated_by, to_config
from cophy.dataset import generation
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.schemas import ACTIONS, StudyConfig


@cli.command("study")
def run_study(cfg: DictConfig) -> None:
    config = to_config(cfg, StudyConfig)
    num_objects = config.num_objects or [config.split.test.num_objects]
    if len(num_objects) != 1:
        raise CophyError(f"num_objects={num_objects}: a study shows experiments with one number of objects")
    if config.action == "serve" and not all(map(importlib.util.find_spec, ("markdown_it", "starlette", "uvicorn"))):
        raise CophyError("the study needs more packages: pip install -e '.[study]'")
    (states,) = generated_by(replace(config, num_objects=num_objects))
    generation.ensure(states, workers=config.workers)
    _run_action(config, states)


def _run_action(config: StudyConfig, states: States) -> None:
    """Run one action; imports are here so that --help is quick, and serving alone needs the packages of `study`."""
    from cophy.study.experiments import StudyExperiments

    experiments = StudyExperiments(states, config.split, config.study, Path(config.directory))
    if config.action == "serve":
        from cophy.study.server import serve

        serve(
            experiments,
            welcome=None if config.welcome is None else Path(config.welcome),
            limits=config.limits,
            host=config.host,
            port=config.port,
            trusted_proxies=config.trusted_proxies,
            workers=config.workers,
        )
    elif config.action == "export":
        from cophy.study.judging import export_answers

        export_answers(experiments)
    elif config.action == "simulate":
        from cophy.study.simulation import simulate

        simulate(experiments, participants=config.participants, workers=config.workers)
    else:
        from cophy.study.simulation import estimate_power

        estimate_power(experiments)


def main() -> None:
    """Run the command. Its first word may be an action: study.py export."""
    if sys.argv[1:2] and sys.argv[1] in ACTIONS:
        sys.argv[1] = f"action={sys.argv[1]}"
    run_study()
