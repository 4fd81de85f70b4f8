"""Train and test one row of a table: python src/train.py scenario=balls model=cophynet"""

import logging
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from cophy import cli, config

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="train")
def main(cfg: DictConfig) -> float:
    from cophy.training.row import Row
    from cophy.training.run import run_row  # Lightning takes seconds to import; --help does not need it

    chosen = HydraConfig.get().runtime
    source = chosen.choices["source"]
    row = Row(
        **{group: chosen.choices[group] for group in ("scenario", "split", "model", "ablation")},
        size=chosen.choices["size"] if source == "generated" else source,  # released data have the size they have
        positions=cfg.positions,
        seed=cfg.seed,
        directory=Path(chosen.output_dir),
    )
    resolved = OmegaConf.to_container(cfg, resolve=True, enum_to_str=True)
    row.start()
    try:
        settings: config.TrainConfig = cli.to_config(cfg)
        return run_row(settings, row, resolved).get("mse", float("nan"))
    except Exception as error:
        row.fail(error)
        if HydraConfig.get().mode is RunMode.MULTIRUN:  # the other rows go on; Hydra names only the first that failed
            trace = not cli.is_mendable(error)
            logging.getLogger(__name__).error("%s failed: %s", row.place, error, exc_info=trace)
        raise


if __name__ == "__main__":
    cli.run(main)
