"""Pictures of C and clips of AB that browsers play, drawn from the states once and kept beside the answers."""

import multiprocessing
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from cophy.atomic_files import appearing_whole, check_space, without_leftovers
from cophy.drawing.overview import render_sequence
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering import Renderer
from cophy.study.experiments import StudyExperiments
from cophy.workers import begin_worker, ending_workers

CODEC = "VP90"  # VP9 4:2:0 in WebM, which all browsers play; OpenCV's wheel brings the encoder
PICTURE, CLIP = "c.png", "ab.webm"
EXPERIMENT_ARRAYS = ("states", "presence", "shape", "background_seed")


def pictures_of(directory: Path, scenario: str, data: str, resolution: int) -> Path:
    """Where a study keeps its pictures.

    Args:
        directory: Of the study.
        scenario: Its name.
        data: Id of the dataset.
        resolution: Pixels.
    """
    return directory / "pictures" / f"{scenario}-{data}-{resolution}"


class Clips:
    """A folder with two files per experiment. Only C's first frame and AB are ever drawn, never D."""

    def __init__(self, directory: Path, experiments: StudyExperiments) -> None:
        of = experiments.scenario.name, experiments.states.id, experiments.settings.resolution
        self.directory, self._experiments = pictures_of(directory, *of), experiments

    def path(self, experiment: int, what: str) -> Path:
        """Of the PICTURE or the CLIP of an experiment."""
        return self.directory / f"{experiment}-{what}"

    def ensure(self, *, workers: int) -> None:
        """Draw what is missing."""
        missing = [
            experiment
            for experiment in self._experiments.shown
            if not all(self.path(experiment, what).exists() for what in (PICTURE, CLIP))
        ]
        if not missing:
            return
        self.directory.mkdir(parents=True, exist_ok=True)
        arrays = {name: self._experiments.arrays[name][missing] for name in EXPERIMENT_ARRAYS}
        parts = [list(part) for part in np.array_split(np.arange(len(missing)), min(len(missing), 4 * workers))]
        context = multiprocessing.get_context("spawn")
        with (
            without_leftovers(self.directory),
            tqdm(total=len(missing), desc="pictures of C, AB") as bar,
            ProcessPoolExecutor(workers, context, begin_worker) as pool,
            ending_workers(),
        ):
            jobs = [
                pool.submit(
                    _draw,
                    self._experiments.scenario,
                    self._experiments.settings.resolution,
                    {name: values[part] for name, values in arrays.items()},
                    [self.directory / str(missing[row]) for row in part],
                )
                for part in parts
            ]
            try:
                for job in jobs:
                    bar.update(job.result())
            except BrokenProcessPool as error:
                raise CophyError(
                    "a worker process was killed (out of memory?): pictures that are done are kept, run again with fewer "
                    "workers="
                ) from error


def _draw(scenario: Scenario, resolution: int, arrays: dict[str, np.ndarray], stems: list[Path]) -> int:
    """Write both files of each experiment; in a worker."""
    with Renderer(scenario, resolution) as renderer:
        for row, stem in enumerate(stems):
            after = render_sequence(renderer, arrays, row, 1, [0]).rgb[0]
            before = render_sequence(renderer, arrays, row, 0, slice(None)).rgb
            with appearing_whole(stem.with_name(f"{stem.name}-{PICTURE}")) as path:
                path.write_bytes(_png(after))
            with appearing_whole(stem.with_name(f"{stem.name}-{CLIP}")) as path:
                _write_clip(path, before, scenario.clock.frame_rate_hz)
    return len(stems)


def _png(picture: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1])


def _write_clip(path: Path, frames: Iterable[np.ndarray], frame_rate_hz: int) -> None:
    """WebM from (R, R, 3) RGB frames. OpenCV chooses the container by the name, so it writes to one of its own.

    Raises:
        OSError: The disk is full.
        CophyError: What OpenCV wrote, without a word, is not all of it.
    """
    frames = list(frames)
    height, width = frames[0].shape[:2]
    named = path.with_name(f"{path.name}.webm")
    try:
        writer = cv2.VideoWriter(str(named), cv2.VideoWriter.fourcc(*CODEC), frame_rate_hz, (width, height))
        if not writer.isOpened():
            check_space(named)
            raise CophyError(f"{named}: this OpenCV writes no {CODEC} in WebM; install opencv-python-headless")
        for frame in frames:
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        writer.release()
        check_space(named)
        if (written := _count_frames(named)) != len(frames):
            raise CophyError(f"{named}: {written} of {len(frames)} frames could be written; is there space for it?")
        named.replace(path)
    finally:
        named.unlink(missing_ok=True)


def _count_frames(path: Path) -> int:
    video, count = cv2.VideoCapture(str(path)), 0
    while video.grab():
        count += 1
    return count
