"""Score predictions of any model: python src/score.py scenario=collision predictions=mine.npz"""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from cophy import cli
from cophy.atomic_files import sha256
from cophy.config import generated_by, require_scenario, to_config, value_text, variant
from cophy.errors import CophyError, check_name
from cophy.schemas import ScoreConfig
from cophy.scoring import Predictions, Scores, aligned, mse_of_copies, score
from cophy.submission import TestedSplit, read_predictions_file, read_test_split, write_template
from cophy.training.run import SCORED_FILE, Results, Run

FAR = 100  # ours: times the MSE of copies
log = logging.getLogger(__name__)


@cli.command("score")
def main(cfg: DictConfig) -> None:
    from cophy.report.run_summary import show_results  # pandas takes a second; --help does not need it

    require_scenario()
    config = to_config(cfg, ScoreConfig)
    sets = {each.spec.num_objects: each for each in generated_by(config)}
    test = read_test_split(sets[config.split.test.num_objects], config.scenario, config.split)
    truth = test.truth.position
    if config.template is not None:
        write_template(Path(config.template), test)
        log.info("%s: %d experiments, positions of shape %s", config.template, *(len(truth), truth.shape))
        return
    path = Path(str(config.predictions))
    run = make_run(config, path, sets[config.split.test.num_objects].spec.overrides)
    with run.locked(tests=SCORED_FILE):
        predictions = read_predictions_file(path, test.truth)
        scores = score(predictions, test.truth)
        run.delete_earlier_results()
        training_set = sets[config.split.train.num_objects]
        num_train = 0  # the training data need not be here
        if training_set.is_finished():
            num_train = int(config.split.train.select_split(training_set.load(), "train", config.scenario).sum())
        baselines = copies(test)
        if scores.mse.mean() > FAR * max(baselines.values()):
            log.warning(
                "The MSE is over %d times that of copy C and copy B: are the positions in metres, and of D?", FAR
            )
        facts = {
            SCORED_FILE: sha256(path),
            "dataset_ids": [test.dataset_id],
            "groups": scores_of_groups(scores, test),
            "num_train": num_train,
            "num_test": len(scores.experiment),
            "max_epochs": 0,
            "metric_dims": test.truth.metric_dims,
            **dict.fromkeys(("training_seconds", "training_cpu_seconds"), 0.0),
            "wall_seconds": 0.0,
        }
        run.write_results(Results(scores.values, scores.cluster, baselines, run_arrays(predictions, test)), facts)
    show_results(run)
    print(leaderboard_lines(run, config.data_seed, facts, scores), end="")  # noqa: T201 (to be copied)


def leaderboard_lines(run: Run, data_seed: int, facts: dict[str, Any], scores: Scores) -> str:
    """Return the lines of these scores for an entry of leaderboard/."""
    means, intervals = scores.means(), scores.intervals()
    lines = {name: getattr(run, name) for name in ("scenario", "split", "size", "seed", "positions")}
    lines |= {"data_seed": data_seed, "sha256": facts[SCORED_FILE], "num_test": facts["num_test"]}
    for name in (each for each in ("mse", "twin_difference_explained", "right_twin_chosen") if each in means):
        lines[name] = [float(f"{value:.6g}") for value in (means[name], *intervals[name])]
    text = yaml.safe_dump([lines], sort_keys=False, default_flow_style=None, width=1000)
    return f"For leaderboard/, below scores:\n{text}"


def make_run(config: ScoreConfig, path: Path, changes: tuple[str, ...]) -> Run:
    """Return the names and directory of the run that holds the scores, as train.py names its own."""
    choices = HydraConfig.get().runtime.choices
    if changes:
        raise CophyError("score.py scores data of scenario=, size= and data_seed= alone")
    name = path.stem if config.name is None else config.name
    try:
        check_name("name", name)
    except ValueError as error:
        raise CophyError(str(error)) from error
    names = {"size": config.size.name, "data_seed": config.data_seed}
    defaults = {"size": "small", "data_seed": 0}  # of train.py
    changed = {key: value for key, value in names.items() if value != defaults[key]}
    run = Run(
        scenario=choices["scenario"],
        split=choices["split"],
        model=name,
        ablation="full",
        positions=config.positions,
        seed=config.seed,
        size=choices["size"],
        variant=variant(changed),
        directory=Path(),
        changes={key: value_text(value) for key, value in changed.items()},
    )
    run.directory = Path(config.outputs) / run.place
    return run


def scores_of_groups(scores: Scores, test: TestedSplit) -> dict[str, Any]:
    """Return the mean of every measure and its interval for each cell and do-operation."""
    groups: dict[str, Any] = {}
    for kind, masks in test.groups.items():
        groups[kind] = {}
        for name, mask in masks.items():
            selected = scores.select(mask)
            means, intervals = selected.means(), selected.intervals()
            groups[kind][name] = {"num_test": int(mask.sum()), "metrics": means, "intervals": intervals}
    return groups


def copies(test: TestedSplit) -> dict[str, float]:
    """Return the MSE of copy C and of copy B, as `cophy.models.baselines` defines them."""
    truth = test.truth
    positions = {"copy_c": np.broadcast_to(truth.initial[:, None], truth.position.shape), "copy_b": test.observed}
    return mse_of_copies(positions, truth)


def run_arrays(predictions: Predictions, test: TestedSplit) -> dict[str, np.ndarray]:
    """Return the arrays of predictions.npz, in the order of the truth."""
    truth, matched = test.truth, aligned(predictions, test.truth)
    names = ("experiment", "pair", "cluster", "cell", "initial", "presence", "stable")
    arrays = {name: getattr(truth, name) for name in names} | {"target": truth.position}
    predicted = {name: getattr(matched, name) for name in ("position", "stable_logit")}
    return arrays | {name: array for name, array in predicted.items() if array is not None}
