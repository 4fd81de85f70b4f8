"""Export generated data in the format of CoPhy_224: python src/export.py scenario=balls root=/where/CoPhy_224"""

from pathlib import Path

from omegaconf import DictConfig

from cophy import cli
from cophy.config import generated_by, to_config
from cophy.schemas import ExportConfig


@cli.command("export")
def main(cfg: DictConfig) -> None:
    from cophy.released.export import export

    settings = to_config(cfg, ExportConfig)
    root = Path(settings.root)
    root.mkdir(parents=True, exist_ok=True)
    for states in generated_by(settings):
        images = states.frames(settings.render).best_available() if settings.clips else None
        (states if images is None else images).finished_checksums()  # otherwise an error that names the command
        export(states, images, root)
