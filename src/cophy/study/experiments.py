"""The experiments of a study, where objects are in its images, and the files that browsers show: images of C, clips of AB."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from cophy.atomic_files import appearing_whole, without_leftovers
from cophy.dataset.images import render_sequence
from cophy.dataset.splits import SPLITS, Split
from cophy.dataset.states import States, sort_by_twins
from cophy.drawing.files import write_image, write_video
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering import Renderer
from cophy.study.plan import SETTINGS, StudySettings, StudyTask, plan_tasks, practice_tasks, select_pairs
from cophy.workers import worker_pool

AB, CD = 0, 1  # index of the sequence in arrays
IMAGE, CLIP = "c.png", "ab.webm"  # ends of file names
CODEC = "VP90"  # which all browsers play
RENDERED_ARRAYS = ("states", "presence", "shape", "background_seed")

Positions = dict[int, tuple[float, float]]  # slot -> x, y in pixels


class Scenes:
    """Objects of a dataset's experiments in the images of the camera."""

    def __init__(self, scenario: Scenario, arrays: dict[str, np.ndarray], resolution: int) -> None:
        """Project the experiments of `arrays` (see `States.load`) to square images of `resolution` pixels."""
        self.scenario, self.resolution, self._arrays = scenario, resolution, arrays

    def __len__(self) -> int:
        return len(self._arrays["presence"])

    def slots(self, experiment: int) -> set[int]:
        """Return the slots of the objects in C."""
        return set(np.flatnonzero(self._arrays["presence"][experiment, CD]).tolist())

    def objects(self, experiment: int) -> list[dict[str, Any]]:
        """Return slot, name, color and position in the image (`at`) of the objects in C, the lowest object first."""
        pixels = self._project(experiment, CD, 0)
        height = self._arrays["states"][experiment, CD, 0, :, 2]
        names = list(self.scenario.colors.items())
        return [
            {"slot": slot, "name": names[slot][0], "color": names[slot][1], "at": pixels[slot].round(1).tolist()}
            for slot in sorted(self.slots(experiment), key=lambda slot: (height[slot], slot))
        ]

    def starts(self, experiment: int) -> Positions:
        """Return the positions of the objects in C."""
        return self._by_slot(experiment, self._project(experiment, CD, 0))

    def ends(self, experiment: int) -> Positions:
        """Return the positions of the objects at the end of D; they are sent only after an answer to a practice task."""
        return self._by_slot(experiment, self._project(experiment, CD, -1))

    def moved_as_in_ab(self, experiment: int) -> Positions:
        """Return where the objects of C would end if they moved, in the image, as in AB."""
        motion = self._project(experiment, AB, -1) - self._project(experiment, AB, 0)
        return self._by_slot(experiment, self._project(experiment, CD, 0) + motion)

    def _by_slot(self, experiment: int, pixels: np.ndarray) -> Positions:
        return {slot: (float(pixels[slot][0]), float(pixels[slot][1])) for slot in sorted(self.slots(experiment))}

    def _project(self, experiment: int, sequence: int, frame: int) -> np.ndarray:
        """Return the pixels (slot, 2) of the objects at a frame of AB or CD."""
        states = self._arrays["states"][experiment, sequence, :: self.scenario.clock.states_per_frame]
        return self.scenario.camera.project(states[frame, :, :3], self.resolution)


def image_directory(directory: Path, scenario: str, data: str, resolution: int) -> Path:
    """Return the folder of the images of a study.

    Args:
        resolution: Width and height of the images, pixels.
    """
    return directory / "pictures" / f"{scenario}-{data}-{resolution}"


class StudyExperiments:
    """Twin pairs of the test split that participants see, and pairs of the validation split for practice.

    Only C's first frame and AB are drawn, never D.

    Args:
        split: Split whose test half is shown.

    Raises:
        CophyError: The dataset has too few twin pairs.
    """

    def __init__(self, states: States, split: Split, settings: StudySettings, directory: Path) -> None:
        self.states, self.split, self.settings, self.directory = states, split, settings, directory
        self.scenario = states.spec.scenario
        self.arrays = sort_by_twins(states.load(), states.spec)
        self.scenes = Scenes(self.scenario, self.arrays, settings.resolution)
        test_pairs = self._select(split, "test")
        cells = self.arrays["cell"].reshape(-1, 2)
        self.pairs = select_pairs(test_pairs, cells[test_pairs], settings)
        self.kinds = cells[self.pairs]
        practice_pairs = self._select(split, "val")
        if len(practice_pairs) < len(SETTINGS):
            raise CophyError(f"the validation split has no {len(SETTINGS)} twin pairs for practice: {states.remedy}")
        self.practice = practice_tasks(practice_pairs, settings)
        self.study_id = settings.study_id(self.scenario.name, states.id, split.name)
        self.image_directory = image_directory(directory, self.scenario.name, states.id, settings.resolution)

    def _select(self, split: Split, part: str) -> np.ndarray:
        """Return the pairs of a part whose twins both belong to the split's test half."""
        selected = split.test.select(self.arrays, self.scenario) & (self.arrays["split"] == SPLITS.index(part))
        return np.flatnonzero(selected.reshape(-1, 2).all(axis=1))

    @property
    def shown(self) -> list[int]:
        """Indices of all experiments that participants see."""
        practice = {task.experiment for task in self.practice}
        return sorted({*practice, *(2 * self.pairs).tolist(), *(2 * self.pairs + 1).tolist()})

    @property
    def description(self) -> str:
        """What the report needs to find the data again, as JSON."""
        spec = self.states.spec
        data = {"data": self.states.id, "data_seed": spec.data_seed, "overrides": spec.overrides}
        experiments = {"num_objects": spec.num_objects, "size": spec.size.name, **data}
        images = {"resolution": self.settings.resolution, "seconds": self.settings.seconds}
        return json.dumps({"scenario": self.scenario.name, "split": self.split.name, **experiments, **images})

    def tasks(self, number: int) -> list[StudyTask]:
        """Return the tasks of a participant, practice first."""
        return [*self.practice, *plan_tasks(number, self.pairs, self.kinds, self.settings)]

    def file(self, experiment: int, name: str) -> Path:
        """Return the path of the IMAGE or the CLIP of an experiment."""
        return self.image_directory / f"{experiment}-{name}"

    def draw_missing(self, *, workers: int) -> None:
        """Draw the images and clips that do not exist yet."""
        missing = [e for e in self.shown if not all(self.file(e, name).exists() for name in (IMAGE, CLIP))]
        if not missing:
            return
        self.image_directory.mkdir(parents=True, exist_ok=True)
        parts = [part.tolist() for part in np.array_split(missing, min(len(missing), 4 * workers))]
        arrays = [{name: self.arrays[name][part] for name in RENDERED_ARRAYS} for part in parts]
        stems = [[self.image_directory / str(experiment) for experiment in part] for part in parts]
        draw = partial(_draw, self.scenario, self.settings.resolution)
        with (
            without_leftovers(self.image_directory),
            tqdm(total=len(missing), desc="images of C, clips of AB") as bar,
            worker_pool(workers) as pool,
        ):
            for num_drawn in pool.map(draw, arrays, stems):
                bar.update(num_drawn)


def _draw(scenario: Scenario, resolution: int, arrays: dict[str, np.ndarray], stems: list[Path]) -> int:
    """Write image and clip of each experiment of `arrays`; return their number."""
    with Renderer(scenario, resolution) as renderer:
        for row, stem in enumerate(stems):
            image = render_sequence(renderer, arrays, row, CD, [0]).rgb[0]
            clip = render_sequence(renderer, arrays, row, AB, slice(None)).rgb
            write_image(stem.with_name(f"{stem.name}-{IMAGE}"), image)
            with appearing_whole(stem.with_name(f"{stem.name}-{CLIP}")) as path:
                write_video(path, clip, frame_rate_hz=scenario.clock.frame_rate_hz, codec=CODEC)
    return len(stems)
