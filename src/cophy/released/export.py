"""A generated dataset and its pictures, to a folder in the format of CoPhy_224.

Lists of ids of an export: which experiments train, validate and test, for every kind of split that was released.
The files of one exported experiment, as CoPhy_224 has them.
"""

import io
import json
import logging
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from filelock import FileLock
from PIL import ImageColor

from cophy.atomic_files import check_space, read_plain, write_atomically
from cophy.dataset.generation import progress_bar
from cophy.dataset.images import Images
from cophy.dataset.replay import do_operation_of
from cophy.dataset.splits import SPLITS, Part
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.released.formats import SEQUENCES, TASKS, CoPhyTask
from cophy.scenario import Remove, Scenario, Shape
from cophy.scenario.rendering import NO_OBJECT

log = logging.getLogger(__name__)


def exported_lists(arrays: dict[str, np.ndarray], task: CoPhyTask, num_objects: int) -> dict[str, np.ndarray]:
    """Name of each list -> experiments.

    Args:
        arrays: of the dataset.
        task: whose kinds of lists are wanted.
        num_objects: in A of every experiment.
    """
    found = {}
    for kind in task.kinds:
        trained, tested = _parts(kind, num_objects)
        for split in SPLITS:
            part = tested if split == "test" else trained
            rows = part.select_split(arrays, split)
            found[task.list_of(split, num_objects, kind)] = np.flatnonzero(rows)
    return found


def as_text(rows: np.ndarray) -> bytes:
    """The content of a list."""
    return "".join(f"{row}\n" for row in rows.tolist()).encode()


def _parts(kind: str, num_objects: int) -> tuple[Part, Part]:
    """What is trained and what is tested on: `generalization` and `moving_*` test on what their training leaves out."""
    sphere, cylinder = (Part(num_objects, moving=shape) for shape in ("sphere", "cylinder"))
    seen, unseen = (Part(num_objects, configurations=which) for which in ("seen", "unseen"))
    everything = Part(num_objects)
    return {
        "normal": (everything, everything),
        "generalization": (seen, unseen),
        "moving_sphere": (sphere, cylinder),
        "moving_cylinder": (cylinder, sphere),
    }[kind]


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


FORMAT_VERSION = 1  # raise it when what is exported changes
MARKER = "export.json"  # whose experiments a folder holds
NEEDED = ("rgb", "segmentation")


def export(states: States, images: Images | None, root: Path) -> Path:
    """Write a dataset; goes on where it was stopped, and overwrites nothing else.

    Args:
        states: Generated.
        images: Its pictures, rendered; None for states without clips and boxes.
        root: The folder that holds the exports of all tasks.

    Returns:
        The folder of its experiments, below `root`.

    Raises:
        CophyError: pictures are missing, or `root` holds other data.
    """
    if images is not None and not set(images.render.modalities) >= set(NEEDED):
        raise CophyError("the format holds RGB and segmentation: export with 'render.modalities=[rgb,segmentation]'")
    arrays, spec = states.load(), states.spec
    task = TASKS[spec.scenario.name]
    folder = task.directory(root, spec.num_objects)
    lists = exported_lists(arrays, task, spec.num_objects)
    _claim(folder, states, images, root / "splits", lists)
    with FileLock(folder / ".lock"):
        for leftover in folder.glob(".*.tmp"):
            shutil.rmtree(leftover)
        missing = [row for row in range(len(arrays["split"])) if not (folder / str(row)).exists()]
        for row, pictures in ((row, None) for row in missing) if images is None else _pictures(images, missing):
            _write_whole(folder / str(row), Exported(spec.scenario, arrays, row, pictures))
    (root / "splits").mkdir(exist_ok=True)
    for name, rows in lists.items():
        write_atomically(root / "splits" / name, as_text(rows))
    log.info("%s: %d experiments; read back with\n    %s", folder, len(arrays["split"]), read_back(spec.scenario, root))
    return folder


def read_back(scenario: Scenario, root: Path) -> str:
    """The command that trains on an export: its confounders and camera are ours, not those of the released data."""
    names = ["mass", "friction", "restitution"]
    if TASKS[scenario.name].has_gravity:
        names += ["gravity_x", "gravity_y"]
    values = {f"confounders.{name}": getattr(scenario.confounders, name) for name in names}
    values |= {f"camera.{name}": getattr(scenario.camera, name) for name in ("eye", "target")}
    lists = [f"'scenario.{key}=[{','.join(f'{v:g}' for v in value)}]'" for key, value in values.items()]
    view = f"scenario.camera.field_of_view_deg={scenario.camera.field_of_view_deg:g}"
    return f"python src/train.py source=cophy source.root={root} scenario={scenario.name} {' '.join(lists)} {view}"


def _claim(folder: Path, states: States, images: Images | None, splits: Path, lists: dict[str, np.ndarray]) -> None:
    """Make the folder ours, or refuse one that holds anything else."""
    pictures = None if images is None else images.name
    content = {"format": FORMAT_VERSION, "dataset": states.id, "pictures": pictures}
    marker = folder / MARKER
    try:
        ours = json.loads(read_plain(marker)) == content
    except (OSError, ValueError, RecursionError):
        ours = not folder.exists() or not os.listdir(folder)
    if not ours:
        wanted = f"{states.id} {'without pictures' if pictures is None else f'with {pictures}'}"
        raise CophyError(f"{folder} holds other data than {wanted}: choose another root=")
    for name, rows in lists.items():
        if (splits / name).exists() and read_plain(splits / name) != as_text(rows):
            raise CophyError(f"{splits / name} is a list of other data: choose another root=")
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(marker, (json.dumps(content) + "\n").encode())


def _pictures(images: Images, rows: list[int]) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """(row, RGB, segmentation and boxes of AB and CD), a shard after the other."""
    source = images.or_more()
    source.finished_checksums()
    with progress_bar(f"export of {images.states.title}", len(rows)) as advance_to:
        done = 0
        for shard in range(images.spec.num_shards):
            within = images.spec.experiments_of_shard(shard)
            wanted = [row for row in rows if row in within]
            if not wanted:
                continue
            with source.explained(shard), source.opened(source.path(shard), shard) as stored:
                for row in wanted:
                    yield row, {name: stored[name][row - within.start] for name in (*NEEDED, "boxes")}
                    done += 1
                    advance_to(done)


def _write_whole(path: Path, experiment: Exported) -> None:
    """A folder that is there whole or not at all."""
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        temporary.mkdir()
        write_experiment(temporary, experiment)
        os.replace(temporary, path)
    finally:  # on failure it would keep a full disk full
        shutil.rmtree(temporary, ignore_errors=True)
