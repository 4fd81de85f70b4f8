"""Train and test one model on one split: python src/train.py scenario=balls model=cophynet"""

import logging
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from cophy import cli
from cophy.config import to_config, to_plain, variant
from cophy.dataset.source import GENERATED
from cophy.schemas import TrainConfig, register

log = logging.getLogger(__name__)
if not {"--help", "-h"} & set(sys.argv):  # the schemas of models import torch, which takes seconds
    register(models=True)


@cli.command("train")
def main(cfg: DictConfig) -> float:
    from cophy.assembly import run_configured  # Lightning takes seconds to import; --help does not need it
    from cophy.run_results import show_results
    from cophy.training.run import METRICS, Run, claimed, is_first

    chosen = HydraConfig.get()
    choices = chosen.runtime.choices
    run = Run(
        **{group: choices[group] for group in ("scenario", "split", "model", "ablation")},
        size=choices["size"] if choices["source"] == GENERATED else choices["source"],  # released data have their own
        positions=cfg.positions,
        seed=cfg.seed,
        variant=variant(cfg, HydraConfig.get()),
        directory=Path(chosen.runtime.output_dir),
    )
    plain = to_plain(cfg)
    side_by_side = choices["hydra/launcher"] != "basic"
    if side_by_side:  # their bars would overwrite each other
        plain["trainer"] |= {"enable_progress_bar": False, "enable_model_summary": False}
    try:
        with claimed(run) as claim:
            optimized = run_configured(to_config(cfg, TrainConfig), plain, claim)
    except Exception as error:
        if chosen.mode is RunMode.MULTIRUN:  # the other runs go on; Hydra names only the first that failed
            log.error("%s failed: %s", run.place, error, exc_info=not cli.is_user_error(error))
        raise
    if is_first() and not side_by_side and (run.directory / METRICS).exists():  # a trial leaves none
        show_results(run, cfg.scenario.task.metric_dims)
    return optimized
