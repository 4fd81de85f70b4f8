"""Exports of a generated dataset and its images in the format of CoPhy_224, with a list of ids for every released split."""

import io
import json
import logging
import os
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import ImageColor

from cophy.atomic_files import read_json, read_plain, write_atomically
from cophy.dataset.generation import progress_bar
from cophy.dataset.images import Images
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import SPLITS, Part
from cophy.dataset.states import States, do_operation_of
from cophy.drawing.files import write_video
from cophy.errors import CophyError
from cophy.locks import locked
from cophy.released.formats import SEQUENCE_FOLDERS, TASKS
from cophy.scenario import Remove, Scenario, Shape
from cophy.scenario.rendering import NO_OBJECT

log = logging.getLogger(__name__)


def _export_lists(arrays: dict[str, np.ndarray], spec: DatasetSpec) -> dict[str, bytes]:
    """Return the name and the content of each list, for a dataset."""
    lists, task, num_objects = {}, TASKS[spec.scenario.name], spec.num_objects
    for kind in task.kinds:
        train, test = _parts(kind, num_objects)
        for split, part in zip(SPLITS, (train, train, test), strict=True):
            rows = np.flatnonzero(part.select_split(arrays, split, spec.scenario)).tolist()
            lists[task.list_of(split, num_objects, kind)] = "".join(f"{row}\n" for row in rows).encode()
    return lists


def _parts(kind: str, num_objects: int) -> tuple[Part, Part]:
    """Return the parts that a kind of list trains and tests on: all but `normal` test on what training leaves out."""
    sphere, cylinder = (Part(num_objects, moving=shape) for shape in ("sphere", "cylinder"))
    seen, unseen = (Part(num_objects, configurations=which) for which in ("seen", "unseen"))
    everything = Part(num_objects)
    return {
        "normal": (everything, everything),
        "generalization": (seen, unseen),
        "moving_sphere": (sphere, cylinder),
        "moving_cylinder": (cylinder, sphere),
    }[kind]


BOX_PX = 224  # boxes are in pixels of an image of this size
MIN_UPRIGHT = 0.7  # z component of the axis of an upright cylinder; 0 for one that lies down


class _Experiment:
    """One experiment of a dataset, written in the released format.

    Args:
        pictures: rgb, segmentation and boxes of AB and CD; None for states only.
    """

    def __init__(
        self, scenario: Scenario, arrays: dict[str, np.ndarray], row: int, pictures: dict[str, np.ndarray] | None
    ) -> None:
        self.scenario, self.task, self.pictures = scenario, TASKS[scenario.name], pictures
        self.arrays = {name: array[row] for name, array in arrays.items()}
        self.do_operation = do_operation_of(arrays, row, scenario)
        self.colors = list(scenario.colors)

    def write(self, directory: Path) -> None:
        """Write all files into its folder."""
        for sequence, name in enumerate(SEQUENCE_FOLDERS):
            (directory / name).mkdir()
            self._write_sequence(directory / name, sequence)
        confounders = np.stack([self.arrays[name] for name in self.task.confounders], axis=-1)
        _write_array(directory / "confounders.npy", confounders)
        if self.task.has_gravity:
            x, y, _ = self.arrays["gravity"].tolist()
            (directory / "gravity.txt").write_text(f"gravity_x={x:g} gravity_y={y:g}\n", "utf-8")
        else:
            (directory / "explanations.txt").write_text(self._explanation(), "utf-8")

    def _write_sequence(self, directory: Path, sequence: int) -> None:
        clock, pictures = self.scenario.clock, self.pictures
        length = min(clock.num_frames, self.task.max_frames or clock.num_frames)
        _write_array(directory / "states.npy", self.arrays["states"][sequence, :: clock.states_per_frame][:length])
        (directory / "colors.txt").write_text(self.task.colors_header + "".join(self._color_lines(sequence)), "utf-8")
        if pictures is None:
            return
        boxes = pictures["boxes"][sequence, :length].astype(np.float64)
        _write_array(directory / "bboxes.npy", np.where(boxes < 0, 0.0, boxes * BOX_PX / pictures["rgb"].shape[-2]))
        palette = np.zeros((NO_OBJECT + 1, 3), dtype=np.uint8)  # black where there is no object
        palette[: self.scenario.num_slots] = [ImageColor.getrgb(color) for color in self.scenario.colors.values()]
        segmentation = palette[pictures["segmentation"][sequence, :length]]
        write_video(
            directory / "rgb.mp4", pictures["rgb"][sequence, :length], frame_rate_hz=clock.frame_rate_hz, codec=CODEC
        )
        write_video(directory / "segm.mp4", segmentation, frame_rate_hz=clock.frame_rate_hz, codec=CODEC)

    def _color_lines(self, sequence: int) -> Iterator[str]:
        """Yield a line per object in the scenario's order, with its type where the task has several."""
        order = self.arrays["object_index"]
        for slot in sorted(np.flatnonzero(self.arrays["presence"][sequence]).tolist(), key=lambda slot: order[slot]):
            yield f"{f'type={self._type(slot)} ' if self.task.shape is None else ''}color={self.colors[slot]}\n"

    def _type(self, slot: int) -> str:
        if self.arrays["shape"][slot] == Shape.SPHERE:
            return "sphere"
        x, y = self.arrays["states"][0, 0, slot, 3:5]
        return "cylinder_up" if abs(1 - 2 * (x * x + y * y)) > MIN_UPRIGHT else "cylinder_down"

    def _explanation(self) -> str:
        color = self.colors[self.do_operation.slot]
        if isinstance(self.do_operation, Remove):
            return f"the {color} object is removed\n"
        x, y, z = self.do_operation.offset_m
        return f"the {color} object is displaced by x={x:.4f} y={y:.4f} z={z:.4f}\n"


def _write_array(path: Path, array: np.ndarray) -> None:
    """Write a .npy file of float64; on a full disk np.save itself raises an error without the reason."""
    file = io.BytesIO()
    np.save(file, array.astype(np.float64))
    path.write_bytes(file.getvalue())


CODEC = "mp4v"  # MPEG-4, as the released clips
EXPORT_VERSION = 1  # raise it when the exported files change
MARKER = "export.json"  # names the dataset that a folder holds
NEEDED_MODALITIES = ("rgb", "segmentation")


def export(states: States, images: Images | None, root: Path) -> Path:
    """Write a generated dataset below `root`, the folder of all tasks; resume, and overwrite nothing else.

    Args:
        images: its rendered images; None for states without clips and boxes.
        root: folder of the exports of all tasks.

    Returns:
        The folder of the experiments.

    Raises:
        CophyError: images are missing, or `root` holds other data.
    """
    if images is not None and not set(images.render.modalities) >= set(NEEDED_MODALITIES):
        raise CophyError("the format holds RGB and segmentation: export with 'render.modalities=[rgb,segmentation]'")
    arrays, spec = states.load(), states.spec
    folder = TASKS[spec.scenario.name].directory(root, spec.num_objects)
    lists = _export_lists(arrays, spec)
    _claim(folder, states, images, root / "splits", lists)
    with locked(folder / ".lock", elsewhere="root="):
        for leftover in folder.glob(".*.tmp"):
            shutil.rmtree(leftover)
        missing = [row for row in range(len(arrays["split"])) if not (folder / str(row)).exists()]
        read = None if images is None else images.pictures(arrays, (*NEEDED_MODALITIES, "boxes"))
        with progress_bar(f"export of {states.title}", len(missing)) as bar:
            for row in missing:
                pictures = None if read is None else read(row)
                _write_folder(folder / str(row), _Experiment(spec.scenario, arrays, row, pictures))
                bar.update()
    (root / "splits").mkdir(exist_ok=True)
    for name, text in lists.items():
        write_atomically(root / "splits" / name, text)
    command = _training_command(spec.scenario, root)
    log.info("%s: %d experiments; train on them with\n    %s", folder, len(arrays["split"]), command)
    return folder


def _training_command(scenario: Scenario, root: Path) -> str:
    """Return the command that trains on an export: its confounders and camera are ours, not those of the released data."""
    names = ["mass", "friction", "restitution"]
    if TASKS[scenario.name].has_gravity:
        names += ["gravity_x", "gravity_y"]
    values = {f"confounders.{name}": getattr(scenario.confounders, name) for name in names}
    values |= {f"camera.{name}": getattr(scenario.camera, name) for name in ("eye", "target")}
    lists = [f"'scenario.{key}=[{','.join(f'{v:g}' for v in value)}]'" for key, value in values.items()]
    view = f"scenario.camera.field_of_view_deg={scenario.camera.field_of_view_deg:g}"
    return f"python src/train.py source=cophy {shlex.quote(f'source.root={root}')} scenario={scenario.name} {' '.join(lists)} {view}"


def _claim(folder: Path, states: States, images: Images | None, splits: Path, lists: dict[str, bytes]) -> None:
    """Mark the folder as the export of this dataset, or refuse one that holds anything else."""
    pictures = None if images is None else images.name
    content = {"format": EXPORT_VERSION, "dataset": states.id, "pictures": pictures}
    marker = folder / MARKER
    try:
        ours = read_json(marker) == content
    except (OSError, ValueError):
        ours = not folder.exists() or not os.listdir(folder)
    if not ours:
        expected = f"{states.id} {'without images' if pictures is None else f'with {pictures}'}"
        raise CophyError(f"{folder} holds other data than {expected}: choose another root=")
    for name, text in lists.items():
        if (splits / name).exists() and read_plain(splits / name) != text:
            raise CophyError(f"{splits / name} is a list of other data: choose another root=")
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(marker, (json.dumps(content) + "\n").encode())


def _write_folder(path: Path, experiment: _Experiment) -> None:
    """Write the folder of an experiment as a whole or not at all."""
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        temporary.mkdir()
        experiment.write(temporary)
        os.replace(temporary, path)
    finally:  # free the space on a full disk
        shutil.rmtree(temporary, ignore_errors=True)
