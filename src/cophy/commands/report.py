"""Tables and figures from outputs/, ours next to the paper's numbers: python src/report.py"""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from omegaconf import DictConfig

from cophy import cli
from cophy.config import generated_by, to_config
from cophy.dataset.source import GENERATED
from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.released.formats import FORMATS
from cophy.scenario import Scenario
from cophy.schemas import GenerateConfig, ReportConfig, TrainConfig

# an override of a scenario or a size, as `DatasetSpec` has it; a file of answers may hold any text
DATA_OVERRIDE = re.compile(r"\+\+(scenario|size)\.[\w.]+=[^${}]*")


@cli.command("report")
def main(cfg: DictConfig) -> None:
    config = to_config(cfg, ReportConfig)
    outputs, directory = Path(config.outputs), Path(config.directory)
    if config.compare:
        from cophy.report.comparisons import write_comparisons  # imports SciPy, which --help does not need

        write_comparisons(outputs, directory, config.compare)
        return
    from cophy.report.pipeline import Configurations, Supplement, write_report  # matplotlib takes a second
    from cophy.study.report import draw_studies, read_answers, study_tables, table_numbers

    data = ComposedData(config.source.name, Path(config.data_dir))
    dataset = data.dataset if config.source.is_generated else None
    configurations = Configurations(data.scenario, data.default_split, dataset, data.dataset_ids)
    studies = read_answers(outputs, data.dataset)
    supplement = Supplement(table_numbers(studies), study_tables(studies), draw_studies(studies))
    write_report(
        outputs, directory, configurations, supplement, models=config.models, splits=config.splits, paper=config.paper
    )


class ComposedData:
    """Scenarios, splits and datasets by the names of the configuration; each is composed once.

    Args:
        source: Source of the data that the runs are on.
    """

    def __init__(self, source: str, data_dir: Path) -> None:
        self.source, self.data_dir = source, data_dir
        self._composed = cache(cli.settings_from_python)

    def scenario(self, name: str) -> Scenario:
        """Return the scenario of a name."""
        return self._of_scenario(name).scenario

    def default_split(self, scenario: str) -> Split:
        """Return the default split of a scenario."""
        return self._of_scenario(scenario).split

    def _of_scenario(self, name: str) -> GenerateConfig | TrainConfig:
        if self.source == GENERATED:
            return self._composed("generate", f"scenario={name}", "size=small", "data_seed=0")
        return self._composed("train", f"source={self.source}", f"scenario={name}")

    def dataset_ids(self, scenario: str, size: str) -> frozenset[str] | None:
        """Return the ids of today's datasets of a scenario and size; None for released data, which do not change.

        Raises:
            CophyError: There is no such scenario or size, or it is of another source (runs on released data name it there).
        """
        source = size if size in FORMATS else GENERATED
        if source != self.source:
            raise CophyError(f"its data come from source={source}, but these tables are for source={self.source}")
        self.scenario(scenario)
        if source != GENERATED:
            return None
        composed = self._composed("generate", f"scenario={scenario}", f"size={size}", "data_seed=0")
        counts = composed.size.num_experiments.get(scenario, {})  # some sizes have few
        return frozenset(self.dataset(scenario, int(count), size).id for count in counts)

    def dataset(
        self, scenario: str, num_objects: int, size: str, data_seed: int = 0, overrides: Sequence[str] = ()
    ) -> States:
        """Return a generated dataset.

        Args:
            num_objects: Number of objects in A of every experiment.
            overrides: What it changes beyond its names, see `DatasetSpec`.

        Raises:
            CophyError: This is no configuration of data.
        """
        if invalid := [override for override in overrides if not DATA_OVERRIDE.fullmatch(override)]:
            raise CophyError(f"{invalid[0]!r} is no override of a scenario or a size")
        names = (f"scenario={scenario}", f"size={size}", f"data_seed={data_seed}")
        config = self._composed("generate", *names, *overrides)
        (states,) = generated_by(replace(config, num_objects=[num_objects], data_dir=str(self.data_dir)))
        return states
