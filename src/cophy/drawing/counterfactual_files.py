"""What predict.py writes: predicted positions as a table, a clip and a strip of AB, the truth and the prediction."""

from pathlib import Path

import numpy as np

from cophy.atomic_files import write_atomically
from cophy.drawing.gifs import gif
from cophy.drawing.picture_files import write_picture
from cophy.drawing.sheets import grid, side_by_side
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering.renderer import Renderer

NUM_STRIP_FRAMES = 6
UPRIGHT_XYZW = (0.0, 0.0, 0.0, 1.0)


def render_positions(positions: np.ndarray, presence: np.ndarray, scenario: Scenario, resolution: int) -> np.ndarray:
    """Frames of which only positions are known: shapes are the scenario's guess, and nothing is turned.

    Args:
        positions: (T, K, 3) metres.
        presence: (K,) which slots hold an object.
        scenario: Whose objects and camera to draw with.
        resolution: Pixels.

    Returns:
        (T, resolution, resolution, 3) uint8.
    """
    upright = np.broadcast_to(UPRIGHT_XYZW, (*positions.shape[:2], 4))
    shapes = [int(scenario.shape_from_positions)] * scenario.num_slots
    with Renderer(scenario, resolution) as renderer:
        return renderer.render(positions, upright, presence=presence, shapes=shapes, background_seed=0).rgb


def write_counterfactual(
    directory: Path,
    positions: np.ndarray,
    presence: np.ndarray,
    scenario: Scenario,
    *,
    observed: np.ndarray,
    truth: np.ndarray | None,
) -> None:
    """Write positions.csv, prediction.gif and strip.png.

    Args:
        directory: Where they go.
        positions: (T, K, 3) metres, C and then D as predicted.
        presence: (K,) which slots hold an object.
        scenario: Whose objects and camera to draw with.
        observed: (T, R, R, 3) uint8 frames of AB.
        truth: The same of the true CD, where it is known.

    Raises:
        CophyError: The true frames are not as many or as large as those of AB.
    """
    if truth is not None and truth.shape != observed.shape:
        raise CophyError(f"truth has {truth.shape[:3]} frames, rows and columns, AB has {observed.shape[:3]}")
    directory.mkdir(parents=True, exist_ok=True)
    write_atomically(directory / "positions.csv", _as_csv(positions, presence, scenario).encode())
    sequences = {"observed AB": observed} | ({} if truth is None else {"true CD": truth})
    sequences["predicted CD"] = render_positions(positions, presence, scenario, observed.shape[1])
    clip = side_by_side(sequences)
    write_atomically(directory / "prediction.gif", gif(clip, frames_per_second=scenario.clock.frame_rate_hz))
    times = np.linspace(0, len(clip) - 1, NUM_STRIP_FRAMES).astype(int)
    write_picture(directory / "strip.png", grid([frames[times] for frames in sequences.values()]))


def _as_csv(positions: np.ndarray, presence: np.ndarray, scenario: Scenario) -> str:
    """A line per frame and object."""
    lines = ["frame,object,x_m,y_m,z_m"]
    for time, places in enumerate(positions):
        lines += [
            f"{time},{name},{x:.4f},{y:.4f},{z:.4f}"
            for name, (x, y, z), present in zip(scenario.colors, places, presence, strict=True)
            if present
        ]
    return "\n".join(lines) + "\n"
