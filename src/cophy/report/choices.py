"""What the report asks about the names of runs; the command line answers (`cophy.app.report_choices`)."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from cophy.dataset.splits import Split
from cophy.dataset.store.states import States
from cophy.scenario import Scenario


class Choices(Protocol):
    """What the names under which a run was chosen stand for."""

    def keys_of(self, names: Mapping[str, Any]) -> dict[str, Any]:
        """The keys of the configuration that make a run of these names the run it claims to be, with their values.

        Of a predictor on generated data, `dataset_ids`, too: those that are generated today.

        Raises:
            CophyError: The names compose no configuration, or the run is on data of another source.
        """
        ...

    def scenario(self, name: str) -> Scenario:
        """The scenario of this name."""
        ...

    def split(self, scenario: str, name: str) -> Split:
        """A split of a scenario."""
        ...

    def dataset(
        self, scenario: str, num_objects: int, size: str, data_seed: int = 0, overrides: Sequence[str] = ()
    ) -> States:
        """The generated dataset that runs use, or another one of these names.

        Args:
            scenario: Name of their scenario.
            num_objects: In A of every experiment.
            size: Name of their size.
            data_seed: Of the dataset.
            overrides: What it changes beyond its names, see `DatasetSpec`.

        Raises:
            CophyError: This is no configuration of data.
        """
        ...
