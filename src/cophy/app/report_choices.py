"""What the names of runs stand for, which the report asks: the configurations that they compose."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from cophy.app.cli import explain
from cophy.app.composition import composed, to_config, to_plain
from cophy.app.datasets import generated_by
from cophy.app.schemas.commands import GenerateConfig, TrainConfig
from cophy.dataset.splits import Split
from cophy.dataset.store.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario

OF_EVERY_RUN = ("model", "scenario", "split", "training", "trainer", "data_seed")
OF_DERENDERERS = ("render", "num_images", "num_objects")


class ComposedChoices:
    """See `cophy.report.choices.Choices`. source: of the data that the runs are on."""

    def __init__(self, source: str, data_dir: Path) -> None:
        self.source, self.data_dir = source, data_dir

    def keys_of(self, names: Mapping[str, Any]) -> dict[str, Any]:
        """The keys of the configuration that make a run of these names the run it claims to be."""
        groups = [f"{group}={names[group]}" for group in ("scenario", "split", "model", "ablation")]
        try:
            plain = to_plain(composed("train", f"source={self.source}", *groups))
        except (HydraException, OmegaConfBaseException) as error:
            raise CophyError(explain(error)) from error
        of_pictures = OF_DERENDERERS if names["model"].startswith("derenderer") else ()
        return {key: plain[key] for key in (*OF_EVERY_RUN, *of_pictures)}

    def scenario(self, name: str) -> Scenario:
        """The scenario of this name."""
        return self._train(f"scenario={name}").scenario

    def split(self, scenario: str, name: str) -> Split:
        """A split of a scenario."""
        return self._train(f"scenario={scenario}", f"split={name}").split

    def dataset(self, scenario: str, num_objects: int, size: str) -> States:
        """The dataset that runs of this scenario and size use."""
        chosen = to_config(composed("generate", f"scenario={scenario}", f"size={size}"), GenerateConfig)
        (states,) = generated_by(replace(chosen, num_objects=[num_objects], data_dir=str(self.data_dir)))
        return states

    def _train(self, *overrides: str) -> TrainConfig:
        return to_config(composed("train", f"source={self.source}", *overrides), TrainConfig)
