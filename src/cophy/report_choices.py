"""What the names of runs stand for, which the report asks: the configurations that they compose."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from cophy.cli import explain
from cophy.config import composed, generated_by, to_config, to_plain
from cophy.dataset.source import GENERATED
from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.released.formats import FORMATS
from cophy.report.runs import DATASETS
from cophy.scenario import Scenario
from cophy.schemas import GenerateConfig, TrainConfig

# an override of a scenario or a size, as `DatasetSpec` has it; a file of answers may hold anything
OF_DATA = re.compile(r"\+\+(scenario|size)\.[\w.]+=[^${}]*")
OF_EVERY_RUN = ("model", "scenario", "split", "training", "trainer", "data_seed")
OF_DERENDERERS = ("render", "num_images", "num_objects")


@contextmanager
def _explained() -> Iterator[None]:
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        raise CophyError(explain(error)) from error


@cache
def _generated_ids(scenario: str, split: str, size: str) -> list[str]:
    """The datasets that a run of these names reads, the training one first."""
    chosen = composed("generate", f"scenario={scenario}", f"split={split}", f"size={size}")
    settings = to_config(chosen, GenerateConfig)
    counts = dict.fromkeys(part.num_objects for part in (settings.split.train, settings.split.test))
    return [states.id for count in counts for states in generated_by(replace(settings, num_objects=[count]))]


class ComposedChoices:
    """See `cophy.report.runs.Choices`. source: of the data that the runs are on."""

    def __init__(self, source: str, data_dir: Path) -> None:
        self.source, self.data_dir = source, data_dir

    def keys_of(self, names: Mapping[str, Any]) -> dict[str, Any]:
        """The keys of the configuration that make a run of these names the run it claims to be; see `Choices`."""
        source = names["size"] if names["size"] in FORMATS else GENERATED  # train.py names a run on released data so
        if source != self.source:
            raise CophyError(f"its data are of source={source}, and these tables of source={self.source}")
        groups = [f"{group}={names[group]}" for group in ("scenario", "split", "model", "ablation")]
        is_derenderer = names["model"].startswith("derenderer")
        with _explained():
            plain = to_plain(composed("train", f"source={self.source}", *groups))
            keys = {key: plain[key] for key in (*OF_EVERY_RUN, *(OF_DERENDERERS if is_derenderer else ()))}
            if is_derenderer or self.source != GENERATED:
                return keys
            return keys | {DATASETS: _generated_ids(*(names[name] for name in ("scenario", "split", "size")))}

    def scenario(self, name: str) -> Scenario:
        """The scenario of this name."""
        return self._train(f"scenario={name}").scenario

    def split(self, scenario: str, name: str) -> Split:
        """A split of a scenario."""
        return self._train(f"scenario={scenario}", f"split={name}").split

    def dataset(
        self, scenario: str, num_objects: int, size: str, data_seed: int = 0, overrides: Sequence[str] = ()
    ) -> States:
        """The dataset that runs of this scenario and size use, or another one; see `Choices`."""
        if strange := [each for each in overrides if not OF_DATA.fullmatch(each)]:
            raise CophyError(f"{strange[0]!r} is no override of a scenario or a size")
        with _explained():
            words = (f"scenario={scenario}", f"size={size}", f"data_seed={data_seed}", *overrides)
            chosen = to_config(composed("generate", *words), GenerateConfig)
        (states,) = generated_by(replace(chosen, num_objects=[num_objects], data_dir=str(self.data_dir)))
        return states

    def _train(self, *overrides: str) -> TrainConfig:
        return to_config(composed("train", f"source={self.source}", *overrides), TrainConfig)
