"""A generated dataset and its pictures, to a folder in the format of CoPhy_224."""

import json
import logging
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from filelock import FileLock

from cophy.atomic_files import read_plain, write_atomically
from cophy.dataset.generation import progress_bar
from cophy.dataset.pictures.images import Images
from cophy.dataset.released.export.experiment_files import Exported, write_experiment
from cophy.dataset.released.export.exported_lists import as_text, exported_lists
from cophy.dataset.released.formats.cophy_tasks import TASKS
from cophy.dataset.store.states import States
from cophy.errors import CophyError
from cophy.scenario import Scenario

log = logging.getLogger(__name__)

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
