"""The files of one exported experiment, as CoPhy_224 has them."""

import io
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import ImageColor

from cophy.atomic_files import check_space
from cophy.dataset.released.formats.columns import SEQUENCES
from cophy.dataset.released.formats.cophy_tasks import TASKS, CoPhyTask
from cophy.dataset.replay import do_operation_of
from cophy.errors import CophyError
from cophy.scenario import Remove, Scenario, Shape
from cophy.scenario.rendering.frames import NO_OBJECT

BOX_PX = 224  # boxes are in pixels of a picture of this size
MIN_UPRIGHT = 0.7  # z component of the axis of a cylinder that stands; it is 0 where the cylinder lies


@dataclass(frozen=True)
class Exported:
    """One experiment. arrays: of its dataset; row: its place there. pictures: rgb, segmentation and boxes of AB and CD,
    or None for states alone.
    """

    scenario: Scenario
    arrays: dict[str, np.ndarray]
    row: int
    pictures: dict[str, np.ndarray] | None

    @property
    def task(self) -> CoPhyTask:
        """What the files of its task look like."""
        return TASKS[self.scenario.name]


def write_experiment(directory: Path, experiment: Exported) -> None:
    """Write all files of an experiment into its folder."""
    for sequence, name in enumerate(SEQUENCES):
        (directory / name).mkdir()
        _write_sequence(directory / name, experiment, sequence)
    arrays, row, task = experiment.arrays, experiment.row, experiment.task
    confounders = np.stack([arrays[name][row] for name in task.confounders], axis=-1).astype(np.float64)
    _write_array(directory / "confounders.npy", confounders)
    if task.has_gravity:
        x, y, _ = arrays["gravity"][row].tolist()
        (directory / "gravity.txt").write_text(f"gravity_x={x:g} gravity_y={y:g}\n")
    else:
        (directory / "explanations.txt").write_text(_explanation(experiment))


def _write_sequence(directory: Path, experiment: Exported, sequence: int) -> None:
    clock, pictures = experiment.scenario.clock, experiment.pictures
    length = min(clock.num_frames, experiment.task.max_frames or clock.num_frames)
    states = experiment.arrays["states"][experiment.row, sequence, :: clock.states_per_frame][:length]
    _write_array(directory / "states.npy", states.astype(np.float64))
    (directory / "colors.txt").write_text(_colors(experiment, sequence))
    if pictures is None:
        return
    boxes = pictures["boxes"][sequence, :length].astype(np.float64)
    _write_array(directory / "bboxes.npy", np.where(boxes < 0, 0.0, boxes * BOX_PX / pictures["rgb"].shape[-2]))
    segmentation = _palette(experiment.scenario)[pictures["segmentation"][sequence, :length]]
    _write_clip(directory / "rgb.mp4", pictures["rgb"][sequence, :length], clock.frame_rate_hz)
    _write_clip(directory / "segm.mp4", segmentation, clock.frame_rate_hz)


def _write_array(path: Path, array: np.ndarray) -> None:
    """As np.save does, which says of a full disk only how many bytes it wrote."""
    file = io.BytesIO()
    np.save(file, array)
    path.write_bytes(file.getvalue())


def _palette(scenario: Scenario) -> np.ndarray:
    """(256, 3) uint8 colour of each slot; black where there is no object."""
    palette = np.zeros((NO_OBJECT + 1, 3), dtype=np.uint8)
    palette[: scenario.num_slots] = [ImageColor.getrgb(color) for color in scenario.colors.values()]
    return palette


def _write_clip(path: Path, frames: np.ndarray, frames_per_second: int) -> None:
    """(T, R, R, 3) uint8 RGB as MPEG-4, as the released clips are; lossy."""
    size = (frames.shape[2], frames.shape[1])
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), frames_per_second, size)  # type: ignore[attr-defined]
    if not writer.isOpened():
        check_space(path)
        raise CophyError(f"{path}: this OpenCV cannot write MPEG-4")
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()
    check_space(path)


def _colors(experiment: Exported, sequence: int) -> str:
    """A line per object in the scenario's order, with its type where the task has several."""
    arrays, row, task = experiment.arrays, experiment.row, experiment.task
    names, order = list(experiment.scenario.colors), arrays["object_index"][row]
    present = sorted(np.flatnonzero(arrays["presence"][row, sequence]).tolist(), key=lambda slot: order[slot])
    types = {slot: f"type={_type(experiment, slot)} " if task.shape is None else "" for slot in present}
    return task.colors_header + "".join(f"{types[slot]}color={names[slot]}\n" for slot in present)


def _type(experiment: Exported, slot: int) -> str:
    arrays, row = experiment.arrays, experiment.row
    if arrays["shape"][row, slot] == Shape.SPHERE:
        return "sphere"
    x, y = arrays["states"][row, 0, 0, slot, 3:5]
    return "cylinder_up" if abs(1 - 2 * (x * x + y * y)) > MIN_UPRIGHT else "cylinder_down"


def _explanation(experiment: Exported) -> str:
    operation = do_operation_of(experiment.arrays, experiment.row, experiment.scenario)
    color = list(experiment.scenario.colors)[operation.slot]
    if isinstance(operation, Remove):
        return f"the {color} object is removed\n"
    x, y, z = operation.offset_m
    return f"the {color} object is displaced by x={x:.4f} y={y:.4f} z={z:.4f}\n"
