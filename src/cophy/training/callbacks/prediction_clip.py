"""A clip of twins below each other, or of one experiment: AB, the true CD and the predicted CD, drawn from positions."""

import cv2
import numpy as np

from cophy.drawing.close_up import REACH
from cophy.drawing.labels.text import Line, text_block
from cophy.drawing.sheets import at, grid
from cophy.scenario import Scenario
from cophy.scenario.rendering.renderer import Renderer

RESOLUTION = 224
NUM_FRAMES = 15  # every second of a sequence of 30: enough to follow what moves, and rendered in half the time
HEADINGS = ("AB: observed", "CD: true", "CD: predicted")
LABEL_PX = 70
UPRIGHT_XYZW = (0.0, 0.0, 0.0, 1.0)


class PredictionClip:
    """Draws predictions beside the truth, which is rendered only once.

    Shapes are the scenario's guess and nothing is turned, in all columns alike. All are cropped to where true objects move.

    Args:
        observed: (N, T, K, 3) positions in AB, metres.
        counterfactual: (N, T, K, 3) true positions in CD.
        observed_presence: (N, K) which slots hold an object in AB.
        presence: (N, K) which slots hold an object in CD.
        scenario: Whose objects and camera to draw with.
    """

    def __init__(
        self,
        observed: np.ndarray,
        counterfactual: np.ndarray,
        observed_presence: np.ndarray,
        presence: np.ndarray,
        *,
        scenario: Scenario,
    ) -> None:
        self.scenario, self.presence, num_frames = scenario, presence, observed.shape[1]
        self.times = np.linspace(0, num_frames - 1, min(NUM_FRAMES, num_frames)).astype(int)
        true = ((observed, observed_presence), (counterfactual, presence))
        places = [np.moveaxis(positions, 1, 2)[present].reshape(-1, 3) for positions, present in true]
        self.window = scenario.camera.window_around(np.concatenate(places), REACH * scenario.object_size_m)
        self.truth = [self._rendered(*each) for each in true]

    def of(self, predicted: np.ndarray) -> tuple[np.ndarray, float]:
        """(N, T, K, 3) predicted positions in CD -> frames (T', H, W, 3) uint8, and how many to show in a second."""
        columns, rate = [*self.truth, self._rendered(predicted, self.presence)], self.scenario.clock.frame_rate_hz
        said = [f"twin {n}" for n in range(1, len(predicted) + 1)] if len(predicted) > 1 else [""]
        names = [text_block([Line(name, bold=True)] if name else [], LABEL_PX) for name in said]
        frames = []
        for n, time in enumerate(self.times.tolist()):
            top = [text_block([Line(heading), Line(at(time, rate))], RESOLUTION) for heading in HEADINGS]
            rows = [[name, *(column[row][n] for column in columns)] for row, name in enumerate(names)]
            frames.append(grid([[text_block([], LABEL_PX), *top], *rows]))
        return np.stack(frames), rate * (len(self.times) - 1) / (predicted.shape[1] - 1)

    def _rendered(self, positions: np.ndarray, presence: np.ndarray) -> list[list[np.ndarray]]:
        """(N, T, K, 3) and (N, K) -> pictures of each experiment at the times that are shown."""
        shapes = [int(self.scenario.shape_from_positions)] * self.scenario.num_slots
        upright = np.broadcast_to(UPRIGHT_XYZW, (len(self.times), self.scenario.num_slots, 4))
        with Renderer(self.scenario, RESOLUTION) as renderer:
            whole = [
                renderer.render(places[self.times], upright, presence=present, shapes=shapes, background_seed=0).rgb
                for places, present in zip(positions, presence, strict=True)
            ]
        size = (RESOLUTION, RESOLUTION)
        return [
            [cv2.resize(frame, size, interpolation=cv2.INTER_CUBIC) for frame in self.window.cut(frames)]
            for frames in whole
        ]
