"""The experiments of a study: which are shown, to whom, and how the study is called."""

import json

import numpy as np

from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.store.states import States
from cophy.errors import CophyError
from cophy.study.plan import Assignment, assignments_of, chosen_pairs, practice
from cophy.study.scenes import Scenes
from cophy.study.study_settings import SETTINGS, StudySettings


class StudyExperiments:
    """Twin pairs of the test split that participants see, and pairs of the validation split for practice."""

    def __init__(self, states: States, split: Split, settings: StudySettings) -> None:
        self.states, self.settings, self.scenario = states, settings, states.spec.scenario
        self.arrays = states.load()
        self.scenes = Scenes(self.scenario, self.arrays, settings.resolution)
        shown = self._pairs(split.test.select(self.arrays), "test")
        cells = self.arrays["cell"].reshape(-1, 2)
        self.pairs = chosen_pairs(shown, cells[shown], settings)
        self.kinds = cells[self.pairs]
        others = self._pairs(split.test.select(self.arrays), "val")
        if len(others) < len(SETTINGS):
            raise CophyError(f"the validation split has no {len(SETTINGS)} twin pairs for practice: {states.remedy}")
        self.practice = practice(others, settings)
        self.study_id = settings.study_id(f"{self.scenario.name}/{states.id}", split.name)
        self._split = split.name

    def _pairs(self, selected: np.ndarray, split: str) -> np.ndarray:
        """Pairs of a split of which both twins are selected."""
        chosen = selected & (self.arrays["split"] == SPLITS.index(split))
        return np.flatnonzero(chosen.reshape(-1, 2).all(axis=1))

    @property
    def shown(self) -> list[int]:
        """Every experiment that a picture is needed of."""
        return sorted(
            {*(each.experiment for each in self.practice), *(2 * self.pairs).tolist(), *(2 * self.pairs + 1).tolist()}
        )

    @property
    def description(self) -> str:
        """What the report needs to find the data again, as JSON."""
        spec = self.states.spec
        return json.dumps(
            {
                "scenario": self.scenario.name,
                "split": self._split,
                "num_objects": spec.num_objects,
                "size": spec.size.name,
                "data": self.states.id,
                "data_seed": spec.data_seed,
                "overrides": spec.overrides,
                "resolution": self.settings.resolution,
                "seconds": self.settings.seconds,
            }
        )

    def plan(self, number: int) -> list[Assignment]:
        """What participant `number` is asked, in order."""
        return assignments_of(number, self.pairs, self.kinds, self.settings)
