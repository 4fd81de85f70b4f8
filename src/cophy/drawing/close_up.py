"""Frames of a dataset: whole, and cropped to what moves."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from cophy.scenario import Scenario
from cophy.scenario.rendering.camera import Window
from cophy.scenario.rendering.frames import Frames, RenderSettings
from cophy.scenario.rendering.renderer import Renderer

REACH = 3**0.5 / 2  # from the centre of a cube to its corner, in edges
MAX_ENLARGED = 2.0  # a small window is drawn with at most so many times the pixels along an edge


def render_sequence(
    renderer: Renderer, arrays: dict[str, np.ndarray], experiment: int, sequence: int, times: slice | Sequence[int]
) -> Frames:
    """Frames of one sequence of a loaded dataset.

    Args:
        renderer: Of the dataset's scenario.
        arrays: The dataset.
        experiment: Index of the experiment.
        sequence: 0 for AB, 1 for CD.
        times: Which frames.
    """
    states = arrays["states"][experiment, sequence, :: renderer.scenario.clock.states_per_frame][times]
    return renderer.render(
        states[..., :3],
        states[..., 3:7],
        presence=arrays["presence"][experiment, sequence],
        shapes=arrays["shape"][experiment].tolist(),
        background_seed=int(arrays["background_seed"][experiment]),
    )


def window_of(scenario: Scenario, arrays: dict[str, np.ndarray], experiments: Sequence[int]) -> Window:
    """The part of the picture in which everything moves, in all frames of some experiments.

    Args:
        scenario: Of the dataset.
        arrays: The dataset.
        experiments: Their indices.
    """
    rows = list(experiments)
    places = arrays["states"][rows, :, :: scenario.clock.states_per_frame, :, :3]
    present = np.broadcast_to(arrays["presence"][rows][:, :, None], places.shape[:-1])
    return scenario.camera.window_around(places[present], REACH * scenario.object_size_m)


class CloseUp:
    """Frames of some experiments, all cropped alike, to the part of the picture in which something moves.

    What they show is what the stored pictures show; they are drawn with more pixels, so that the crop has as many.
    """

    def __init__(
        self, scenario: Scenario, arrays: dict[str, np.ndarray], experiments: Sequence[int], render: RenderSettings
    ) -> None:
        """Choose the part that is shown.

        Args:
            scenario: Of the dataset.
            arrays: The dataset.
            experiments: Indices of those that are to be seen.
            render: Resolution and backend; the modalities are all.
        """
        self._scenario, self._arrays, self._render = scenario, arrays, render
        self._window = window_of(scenario, arrays, experiments)

    def frames(self, experiment: int, times: slice | Sequence[int]) -> Iterator[Frames]:
        """Those of AB, and then of CD, of an experiment."""
        resolution = math.ceil(self._render.resolution * min(1 / self._window.edge, MAX_ENLARGED))
        with Renderer(self._scenario, resolution, self._render.backend) as renderer:
            for sequence in (0, 1):
                whole = render_sequence(renderer, self._arrays, experiment, sequence, times)
                yield Frames(*map(self._window.cut, whole))
