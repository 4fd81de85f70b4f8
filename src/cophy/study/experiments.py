"""What C shows of every object, and where objects end, in pixels of the study's pictures.

The experiments of a study: which are shown, to whom, and how the study is called.
"""

import json
from typing import Any

import numpy as np

from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.study.sessions import Assignment, assignments_of, chosen_pairs, practice
from cophy.study.settings import SETTINGS, StudySettings


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


AB, CD = 0, 1  # of an array's axis


class Scenes:
    """The experiments of a dataset as a camera sees them."""

    def __init__(self, scenario: Scenario, arrays: dict[str, np.ndarray], resolution: int) -> None:
        """Look at a dataset.

        Args:
            scenario: Of its experiments.
            arrays: Of the dataset, see `States.load`.
            resolution: Of the pictures, pixels.
        """
        self.scenario, self.resolution, self._arrays = scenario, resolution, arrays

    def __len__(self) -> int:
        return len(self._arrays["presence"])

    def slots(self, experiment: int) -> set[int]:
        """Of the objects in C."""
        return set(np.flatnonzero(self._arrays["presence"][experiment, CD]).tolist())

    def objects(self, experiment: int) -> list[dict[str, Any]]:
        """Of C, the lowest first: slot, name and colour, and where the object is in the picture of C."""
        start = self._in_picture(experiment, CD, 0)
        height = self._arrays["states"][experiment, CD, 0, :, 2]
        names = list(self.scenario.colors.items())
        return [
            {"slot": slot, "name": names[slot][0], "color": names[slot][1], "at": start[slot].round(1).tolist()}
            for slot in sorted(self.slots(experiment), key=lambda slot: (height[slot], slot))
        ]

    def ends(self, experiment: int) -> dict[int, tuple[float, float]]:
        """Where each object of C is at the end of D. Never sent before an answer, and then in practice alone."""
        return self._of_objects(experiment, self._in_picture(experiment, CD, -1))

    def starts(self, experiment: int) -> dict[int, tuple[float, float]]:
        """Where each object is in C."""
        return self._of_objects(experiment, self._in_picture(experiment, CD, 0))

    def moved_as_in_ab(self, experiment: int) -> dict[int, tuple[float, float]]:
        """Where each object of C would be if it moved on, in the picture, as it did in AB."""
        moved = self._in_picture(experiment, AB, -1) - self._in_picture(experiment, AB, 0)
        return self._of_objects(experiment, self._in_picture(experiment, CD, 0) + moved)

    def _of_objects(self, experiment: int, pixels: np.ndarray) -> dict[int, tuple[float, float]]:
        return {slot: (float(pixels[slot][0]), float(pixels[slot][1])) for slot in sorted(self.slots(experiment))}

    def _in_picture(self, experiment: int, sequence: int, frame: int) -> np.ndarray:
        """(slot, 2) pixels at a frame of AB or CD."""
        states = self._arrays["states"][experiment, sequence, :: self.scenario.clock.states_per_frame]
        return self.scenario.camera.project(states[frame, :, :3], self.resolution)
