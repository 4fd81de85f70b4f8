"""Train and test one row of a table: python src/train.py scenario=balls model=cophynet"""

from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from cophy import cli, config

config.register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="train")
def main(cfg: DictConfig) -> float:
    from cophy.training.run import Row, run_row  # Lightning takes seconds to import; --help does not need it

    settings: config.TrainConfig = cli.to_config(cfg)
    chosen = HydraConfig.get().runtime
    row = Row(
        **{group: chosen.choices[group] for group in ("scenario", "split", "model", "ablation", "size")},
        positions=settings.positions,
        seed=settings.seed,
        directory=Path(chosen.output_dir),
    )
    resolved = OmegaConf.to_container(cfg, resolve=True, enum_to_str=True)
    return run_row(settings, row, resolved)["mse"]


if __name__ == "__main__":
    cli.run(main)
