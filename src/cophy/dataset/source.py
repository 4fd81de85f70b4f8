"""Where experiments come from: our generator, or a dataset that others released."""

from dataclasses import dataclass
from pathlib import Path

from cophy.dataset.released.formats import FORMATS
from cophy.dataset.released.released_states import ReleasedStates
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.splits import Split
from cophy.dataset.store.experiment_set import ExperimentSet
from cophy.dataset.store.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario

GENERATED = "generated"


@dataclass
class Source:
    """conf/source/*.yaml.

    name: `generated`, or the name of a released format. outputs: where runs on the data go, apart from those on other data.
    root: folder of a released dataset. splits: folder of its lists of ids; None where they lie in or below root.
    """

    name: str
    outputs: str
    root: str | None = None
    splits: str | None = None

    @property
    def is_generated(self) -> bool:
        """Whether the data can be made here."""
        return self.name == GENERATED

    def experiment_set(
        self,
        scenario: Scenario,
        num_objects: int,
        *,
        split: Split,
        size: Size,
        data_seed: int,
        data_dir: Path,
        overrides: tuple[str, ...] = (),
    ) -> ExperimentSet:
        """The experiments with one number of objects.

        Args:
            scenario: as which released data are read.
            num_objects: in A of every experiment.
            split: whose lists of ids are used, of released data.
            size: of generated data; released ones have none.
            data_seed: of generated data; released ones have none.
            data_dir: where generated data, and indices of released ones, lie.
            overrides: see `DatasetSpec`; of generated data.

        Raises:
            CophyError: the released data or their lists are not where they should be.
        """
        if self.is_generated:
            return States(DatasetSpec(scenario, num_objects, size, data_seed, overrides), data_dir)
        if self.root is None:
            raise CophyError(f"source={self.name} needs source.root=, the folder that holds ballsCF, blocktowerCF, …")
        lists = None if self.splits is None else Path(self.splits)
        return ReleasedStates(
            FORMATS[self.name], Path(self.root), scenario, num_objects, split=split, lists=lists, data_dir=data_dir
        )

    def experiment_sets(
        self,
        scenario: Scenario,
        split: Split,
        num_objects: list[int] | None,
        *,
        size: Size,
        data_seed: int,
        data_dir: Path,
        overrides: tuple[str, ...] = (),
    ) -> list[ExperimentSet]:
        """All datasets that the split, or `num_objects`, names.

        Args:
            scenario: of all of them.
            split: whose numbers of objects are meant where `num_objects` is None.
            num_objects: one dataset each.
            size: see `experiment_set`.
            data_seed: see `experiment_set`.
            data_dir: see `experiment_set`.
            overrides: see `experiment_set`.

        Raises:
            CophyError: the split was not made for the scenario, or released data are not there.
        """
        split.check_scenario(scenario)
        return [
            self.experiment_set(
                scenario,
                count,
                split=split,
                size=size,
                data_seed=data_seed,
                data_dir=data_dir,
                overrides=overrides,
            )
            for count in split.counts(num_objects)
        ]


def generated_sets(
    scenario: Scenario,
    split: Split,
    num_objects: list[int] | None,
    *,
    size: Size,
    data_seed: int,
    data_dir: Path,
    overrides: tuple[str, ...] = (),
) -> list[States]:
    """The generated datasets that the split, or `num_objects`, names.

    Args:
        scenario: of all of them.
        split: whose numbers of objects are meant where `num_objects` is None.
        num_objects: one dataset each.
        size: how many experiments they have.
        data_seed: what their randomness follows from.
        data_dir: where they lie.
        overrides: see `DatasetSpec`.

    Raises:
        CophyError: the split was not made for the scenario.
    """
    split.check_scenario(scenario)
    specs = [DatasetSpec(scenario, count, size, data_seed, overrides) for count in split.counts(num_objects)]
    return [States(spec, data_dir) for spec in specs]
