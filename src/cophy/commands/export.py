"""Export generated data in the format of CoPhy_224: python src/export.py scenario=balls root=/where/CoPhy_224"""

from pathlib import Path

from omegaconf import DictConfig

from cophy import cli
from cophy.config import generated_by, to_config
from cophy.dataset import generation
from cophy.schemas import ExportConfig


@cli.command("export")
def main(cfg: DictConfig) -> None:
    from cophy.released.export import export

    settings = to_config(cfg, ExportConfig)
    root = Path(settings.root)
    root.mkdir(parents=True, exist_ok=True)  # fails before anything is generated
    for states in generated_by(settings):
        generation.ensure(states, workers=settings.workers)
        images = states.frames(settings.render) if settings.clips else None
        if images is not None:
            generation.ensure(images, workers=settings.workers)
        export(states, images, root)
