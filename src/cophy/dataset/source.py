"""Where experiments come from: our generator, or a dataset that others released."""

from dataclasses import dataclass
from pathlib import Path

from cophy.dataset.experiment_set import ExperimentSet
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.released.formats import FORMATS
from cophy.released.states import ReleasedStates
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
            scenario: of all of them; released data are read as it says.
            split: whose numbers of objects are meant where `num_objects` is None; of released data, whose lists of ids are used.
            num_objects: one dataset each.
            size: of generated data; released ones have none.
            data_seed: of generated data; released ones have none.
            data_dir: where generated data, and indices of released ones, lie.
            overrides: see `DatasetSpec`; of generated data.

        Raises:
            CophyError: the split was not made for the scenario, or the released data or their lists are not there.
        """
        if self.is_generated:
            return [
                *generated_sets(
                    scenario,
                    split,
                    num_objects,
                    size=size,
                    data_seed=data_seed,
                    data_dir=data_dir,
                    overrides=overrides,
                )
            ]
        split.check_scenario(scenario)
        if self.root is None:
            raise CophyError(f"source={self.name} needs source.root=, the folder that holds ballsCF, blocktowerCF, …")
        form, root, lists = FORMATS[self.name], Path(self.root), None if self.splits is None else Path(self.splits)
        return [
            ReleasedStates(form, root, scenario, count, split=split, lists=lists, data_dir=data_dir)
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
