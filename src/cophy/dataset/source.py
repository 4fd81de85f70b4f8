"""Where experiments come from: our generator, or a dataset that others released."""

from dataclasses import dataclass
from pathlib import Path

from cophy.dataset.external import Clips, ExternalStates, layout_named
from cophy.dataset.images import Images
from cophy.dataset.spec import DatasetSpec, Size
from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering import RenderSettings

GENERATED = "generated"


@dataclass
class Source:
    """conf/source/*.yaml. root: folder of a released dataset. splits: folder of its lists of ids, None for in or below root.

    outputs: where runs on it go, apart from those on other data.
    """

    name: str
    outputs: str
    root: str | None = None
    splits: str | None = None

    @property
    def is_generated(self) -> bool:
        """Whether it can be made here."""
        return self.name == GENERATED

    def states(
        self, scenario: Scenario, num_objects: int, *, split: Split, size: Size, seed: int, data_dir: Path
    ) -> States | ExternalStates:
        """The experiments with so many objects; those of a released dataset have no size and no seed."""
        if self.is_generated:
            return States(DatasetSpec(scenario, num_objects, size, seed), data_dir)
        if self.root is None:
            raise CophyError(f"source={self.name} needs source.root=, the folder that holds ballsCF, blocktowerCF, …")
        lists = None if self.splits is None else Path(self.splits)
        layout = layout_named(self.name)
        return ExternalStates(
            layout, Path(self.root), scenario, num_objects, split=split, lists=lists, data_dir=data_dir
        )


def pictures_of(states: States | ExternalStates, render: RenderSettings) -> Images | Clips:
    """The frames of experiments: rendered, or as they were released whatever `render` says."""
    return Images(states, render) if isinstance(states, States) else Clips(states)
