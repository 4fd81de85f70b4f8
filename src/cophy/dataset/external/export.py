"""Generated data in the layout of CoPhy_224, for code that was written for it."""

import json
import logging
import os
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
from filelock import FileLock

from cophy.dataset import generation
from cophy.dataset.external.cophy import CoPhy
from cophy.dataset.external.layout import TASKS
from cophy.dataset.images import Images
from cophy.dataset.replay import do_operation_of
from cophy.dataset.splits import SPLITS, Part
from cophy.errors import CophyError
from cophy.files import write_atomically
from cophy.scenario import Remove, Scenario, Shape
from cophy.scenario.rendering import NO_OBJECT

log = logging.getLogger(__name__)

FORMAT_VERSION = 1  # raise it when what is exported changes
MARKER = "export.json"  # whose experiments a folder holds
LONGEST = {"collision": 15}  # frames; the released loader of collisions knows no more
BOX_PX = 224  # boxes are in pixels of a picture of this size
NEEDED = {"rgb", "segmentation"}
UPRIGHT = 0.7  # of a cylinder's axis, its z component: between 0 where it lies and 1


def export(images: Images, root: Path) -> Path:
    """Write a dataset whose pictures are there; returns its folder. Goes on where it was stopped, overwrites nothing else."""
    if not set(images.render.modalities) >= NEEDED:
        raise CophyError("the layout holds RGB and segmentation: export with 'render.modalities=[rgb,segmentation]'")
    arrays, scenario = images.states.load(), images.spec.scenario
    folder = CoPhy().directory(root, scenario, images.spec.num_objects)
    lists = _lists(arrays, scenario, images.spec.num_objects)
    _claim(folder, images, root / "splits", lists)
    with FileLock(folder / ".lock"):
        for leftover in folder.glob(".*.tmp"):
            shutil.rmtree(leftover)
        missing = [row for row in range(len(arrays["split"])) if not (folder / str(row)).exists()]
        for row, pictures in _pictures(images, missing):
            write = partial(_write, row=row, arrays=arrays, pictures=pictures, scenario=scenario)
            _appear(folder / str(row), write)
    (root / "splits").mkdir(exist_ok=True)
    for name, rows in lists.items():
        write_atomically(root / "splits" / name, _text(rows))
    log.info("%s: %d experiments; read back with\n    %s", folder, len(arrays["split"]), read_back(scenario, root))
    return folder


def read_back(scenario: Scenario, root: Path) -> str:
    """The command that trains on an export: its confounders and its camera are ours, and not those of the released data."""
    names = ["mass", "friction", "restitution"] + ["gravity_x", "gravity_y"] * (scenario.name == "blocktower")
    values = {f"confounders.{name}": getattr(scenario.confounders, name) for name in names}
    values |= {f"camera.{name}": getattr(scenario.camera, name) for name in ("eye", "target")}
    lists = [f"'scenario.{key}=[{','.join(f'{v:g}' for v in value)}]'" for key, value in values.items()]
    view = f"scenario.camera.field_of_view_deg={scenario.camera.field_of_view_deg:g}"
    return f"python src/train.py source=cophy source.root={root} scenario={scenario.name} {' '.join(lists)} {view}"


def _claim(folder: Path, images: Images, splits: Path, lists: dict[str, np.ndarray]) -> None:
    """Make the folder ours, or refuse one that holds anything else."""
    content = {"format": FORMAT_VERSION, "dataset": images.states.id, "pictures": images.name}
    marker = folder / MARKER
    try:
        ours = json.loads(marker.read_bytes()) == content
    except (OSError, ValueError):
        ours = not folder.exists() or not os.listdir(folder)
    if not ours:
        raise CophyError(f"{folder} holds other data than {images.states.id} with {images.name}: choose another root=")
    for name, rows in lists.items():
        if (splits / name).exists() and (splits / name).read_bytes() != _text(rows):
            raise CophyError(f"{splits / name} is a list of other data: choose another root=")
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(marker, (json.dumps(content) + "\n").encode())


def _lists(arrays: dict[str, np.ndarray], scenario: Scenario, num_objects: int) -> dict[str, np.ndarray]:
    """Name of each list -> experiments. `generalization` and `moving_*` test on what their training leaves out."""
    kinds: dict[str, tuple[Part, Part]] = {"normal": (Part(num_objects), Part(num_objects))}
    if scenario.name == "blocktower":
        kinds["generalization"] = tuple(Part(num_objects, configurations=which) for which in ("seen", "unseen"))  # type: ignore[assignment]
    if scenario.name == "collision":
        shapes = tuple(Part(num_objects, moving=shape) for shape in ("sphere", "cylinder"))
        kinds |= {f"moving_{part.moving}": (part, other) for part, other in (shapes, shapes[::-1])}
    task, found = TASKS[scenario.name], {}
    for kind, (trained, tested) in kinds.items():
        for number, split in enumerate(SPLITS):
            part = tested if split == "test" else trained
            objects = "" if scenario.name == "collision" else f"_{num_objects}"
            ending = "" if scenario.name == "balls" else f"_{kind}"
            rows = part.select(arrays) & (arrays["split"] == number)
            found[f"{task}_{split}{objects}{ending}.txt"] = np.flatnonzero(rows)
    return found


def _text(rows: np.ndarray) -> bytes:
    return "".join(f"{row}\n" for row in rows.tolist()).encode()


def _pictures(images: Images, rows: list[int]) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """(row, RGB, segmentation and boxes of AB and CD), a shard after the other."""
    images.finished_checksums()
    with generation.progress_bar(f"export of {images.states.title}", len(rows)) as advance_to:
        done = 0
        for shard in range(images.spec.num_shards):
            within = images.spec.experiments_of_shard(shard)
            wanted = [row for row in rows if row in within]
            if not wanted:
                continue
            with images.explained(shard):
                images.check(images.path(shard), shard)
                with h5py.File(images.path(shard), "r") as file:
                    for row in wanted:
                        yield row, {name: file[name][row - within.start] for name in (*NEEDED, "boxes")}
                        done += 1
                        advance_to(done)


def _appear(path: Path, write: Callable[[Path], None]) -> None:
    """A folder that is there whole or not at all."""
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.mkdir()
    write(temporary)
    os.replace(temporary, path)


def _write(
    directory: Path, *, row: int, arrays: dict[str, np.ndarray], pictures: dict[str, np.ndarray], scenario: Scenario
) -> None:
    """One experiment."""
    stride = scenario.clock.states_per_frame
    length = min(scenario.clock.num_frames, LONGEST.get(scenario.name, scenario.clock.num_frames))
    palette = np.zeros((NO_OBJECT + 1, 3), dtype=np.uint8)
    palette[: scenario.num_slots] = [[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in scenario.colors.values()]
    for sequence, name in enumerate(("ab", "cd")):
        (directory / name).mkdir()
        np.save(directory / name / "states.npy", arrays["states"][row, sequence, ::stride][:length].astype(np.float64))
        boxes = pictures["boxes"][sequence, :length].astype(np.float64)
        scaled = np.where(boxes < 0, 0.0, boxes * BOX_PX / pictures["rgb"].shape[-2])
        np.save(directory / name / "bboxes.npy", scaled)
        _clip(directory / name / "rgb.mp4", pictures["rgb"][sequence, :length], scenario.clock.frame_rate_hz)
        _clip(
            directory / name / "segm.mp4",
            palette[pictures["segmentation"][sequence, :length]],
            scenario.clock.frame_rate_hz,
        )
        (directory / name / "colors.txt").write_text(_colors(row, sequence, arrays, scenario))
    columns = ("mass", "friction") if scenario.name == "blocktower" else ("mass", "friction", "restitution")
    np.save(directory / "confounders.npy", np.stack([arrays[c][row] for c in columns], axis=-1).astype(np.float64))
    if scenario.name == "blocktower":
        x, y, _ = arrays["gravity"][row].tolist()
        (directory / "gravity.txt").write_text(f"gravity_x={x:g} gravity_y={y:g}\n")
    else:
        (directory / "explanations.txt").write_text(_explanation(row, arrays, scenario))


def _clip(path: Path, frames: np.ndarray, frames_per_second: int) -> None:
    """(T, R, R, 3) uint8 RGB as MPEG-4, as the released clips are; lossy."""
    size = (frames.shape[2], frames.shape[1])
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), frames_per_second, size)  # type: ignore[attr-defined]
    if not writer.isOpened():
        raise CophyError(f"{path}: this OpenCV cannot write MPEG-4")
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()


def _colors(row: int, sequence: int, arrays: dict[str, np.ndarray], scenario: Scenario) -> str:
    """A line per object: towers from bottom to top after a header, collisions with the shape."""
    names, order = list(scenario.colors), arrays["object_index"][row]
    present = sorted(np.flatnonzero(arrays["presence"][row, sequence]).tolist(), key=lambda slot: order[slot])
    header = "from bottom to top\n" if scenario.name == "blocktower" else ""
    kinds = {slot: f"type={_type(row, slot, arrays)} " if scenario.name == "collision" else "" for slot in present}
    return header + "".join(f"{kinds[slot]}color={names[slot]}\n" for slot in present)


def _type(row: int, slot: int, arrays: dict[str, np.ndarray]) -> str:
    if arrays["shape"][row, slot] == Shape.SPHERE:
        return "sphere"
    x, y = arrays["states"][row, 0, 0, slot, 3:5]
    return "cylinder_up" if abs(1 - 2 * (x * x + y * y)) > UPRIGHT else "cylinder_down"


def _explanation(row: int, arrays: dict[str, Any], scenario: Scenario) -> str:
    operation = do_operation_of(arrays, row)
    color = list(scenario.colors)[operation.slot]
    if isinstance(operation, Remove):
        return f"the {color} object is removed\n"
    x, y, z = operation.offset_m
    return f"the {color} object is displaced by x={x:.4f} y={y:.4f} z={z:.4f}\n"
