"""Checkpoints of train.py: written whole or not at all, and read without running code from them."""

import io
import pickle
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins.io.checkpoint_io import CheckpointIO
from omegaconf.errors import OmegaConfBaseException
from torch import Tensor

from cophy.atomic_files import write_atomically
from cophy.errors import CophyError
from cophy.training.trained.plain_values import check_plain

ORIGIN = "origin"  # the key under which a checkpoint says what it is
MAX_BYTES = 4 << 30  # ours: a predictor has a megabyte, the paper's de-renderer some hundred
OF_NETWORK = "network."  # how the names of the network's weights start
# what is raised where values do not fit; anything else is a fault of the code, or of the machine
MISFITS = (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
ERRORS = (*MISFITS, pickle.UnpicklingError, EOFError, MemoryError)  # of what torch cannot read
MAX_CHARACTERS = 300  # of what is said of an error


@dataclass(frozen=True)
class Origin:
    """What a checkpoint was trained as: parts of the run's configuration, as plain values.

    Attributes:
        model: Class (`_target_`) and arguments of the network.
        training: How it was optimised, see `cophy.training.settings`.
        scenario: Keys of the scenario.
        split: Keys of the split.
        size: Keys of the size.
        data_seed: Of the dataset.
        positions: Which positions it saw: true ones, or those that a de-renderer estimates.
        num_objects: Of the images of a de-renderer; None for those that the split names.
        render: Of these images.
        trained_on: What the training batches were a function of, as the datamodule says.
        seed: Of the training; None in checkpoints of earlier versions.
        trainer: Arguments of `lightning.Trainer` that weights depend on; empty in checkpoints of earlier versions.
    """

    model: dict[str, Any]
    training: dict[str, Any]
    scenario: dict[str, Any]
    split: dict[str, Any]
    size: dict[str, Any]
    data_seed: int
    positions: str
    num_objects: list[int] | None
    render: dict[str, Any]
    trained_on: list[Any]
    seed: int | None = None
    trainer: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        parts = (self.model, self.training, self.scenario, self.split, self.size, self.render, self.trainer)
        for part in parts:
            if not isinstance(part, dict):
                raise TypeError(f"{part} is no dictionary")
        if not isinstance(self.num_objects, list | None) or not isinstance(self.trained_on, list):
            raise TypeError("num_objects or trained_on is no list")
        self.model["_target_"], self.scenario["name"], self.split["name"]


@dataclass(frozen=True)
class Checkpoint:
    """What is read of a checkpoint: its origin, the weights of the network, and whether a training can go on from it."""

    origin: Origin
    weights: dict[str, Tensor]
    has_optimizer: bool


class WholeCheckpoints(CheckpointIO):
    """Writes checkpoints whole or not at all, reads local files only, and removes nothing but a run's own checkpoints.

    Lightning's own writes through /tmp, where a full disk truncates, and follows the addresses that a checkpoint names.
    torch stores checksums but does not compare them: a damaged file is refused here.

    Args:
        origin: What is trained; it is stored in every checkpoint.
        directory: The run's checkpoints, the only files that may be removed.
    """

    def __init__(self, origin: Origin, directory: Path) -> None:
        self.origin, self.directory = origin, directory

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        content = io.BytesIO()
        torch.save(checkpoint | {ORIGIN: asdict(self.origin)}, content)
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(Path(path), content.getvalue())

    def load_checkpoint(self, path: Any, map_location: Any = None, weights_only: bool | None = None) -> dict[str, Any]:
        """Return the checkpoint without the state of ModelCheckpoint callbacks, whose paths may be anybody's."""
        content = read_bytes(Path(path))
        check_whole(content, Path(path))
        try:
            checkpoint = torch.load(io.BytesIO(content), map_location=map_location, weights_only=True)
            for key in [key for key in checkpoint.get("callbacks", {}) if key.startswith("ModelCheckpoint")]:
                del checkpoint["callbacks"][key]
        except ERRORS as error:
            raise CophyError(f"{path} is no checkpoint of train.py, or a damaged one") from error
        return dict(checkpoint)

    def remove_checkpoint(self, path: Any) -> None:
        path = Path(path)
        if path.suffix == ".ckpt" and path.parent.resolve() == self.directory.resolve():
            path.unlink(missing_ok=True)


def read_bytes(path: Path) -> bytes:
    """The content of a checkpoint's file."""
    if not path.is_file():
        raise CophyError(
            f"{path} is no file: give a checkpoint of train.py, for example outputs/.../checkpoints/best.ckpt"
        )
    if path.stat().st_size > MAX_BYTES:
        raise CophyError(f"{path} is no checkpoint of train.py: it is larger than {MAX_BYTES >> 30} GiB")
    return path.read_bytes()


def check_whole(content: bytes, source: Path) -> None:
    """Compare the checksums (CRC-32) that torch stored with what is there. A file that torch wrote is not compressed.

    Raises:
        CophyError: They differ, or the file would grow when it is read; the message names `source`.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            size = sum(each.file_size for each in entries)
            if any(each.compress_type != zipfile.ZIP_STORED for each in entries) or size > len(content):
                raise CophyError(f"{source} is no checkpoint of train.py: it is compressed, or its parts overlap")
            damaged = archive.testzip()
    except (*ERRORS, zipfile.BadZipFile, OSError, zlib.error) as error:
        raise CophyError(f"{source} is no checkpoint of train.py, or a damaged one ({error})") from error
    if damaged is not None:
        raise CophyError(f"{source} is damaged ({damaged} is not what was written): take another, or train again")


def read_checkpoint(content: bytes, source: Path) -> Checkpoint:
    """What train.py saved.

    Raises:
        CophyError: It is something else; the message names `source`.
    """
    check_whole(content, source)
    try:
        saved = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        said, weights = saved[ORIGIN], dict(saved["state_dict"])
        of_network = {key: value for key, value in weights.items() if key.startswith(OF_NETWORK)}
    except ERRORS as error:
        raise CophyError(f"{source} is no checkpoint of train.py, or a damaged one") from error
    with made_from(source):
        check_plain(said)
        origin = Origin(**said)
    network = {key.removeprefix(OF_NETWORK): value for key, value in of_network.items()}
    return Checkpoint(origin, network, has_optimizer="optimizer_states" in saved)


@contextmanager
def made_from(source: Path) -> Iterator[None]:
    """Around what is made from what a checkpoint says, and nothing else: where it says nonsense, it is named.

    Raises:
        CophyError: It does not fit what is made from it.
    """
    try:
        yield
    except (*MISFITS, CophyError, OmegaConfBaseException) as error:
        what = "a key is missing: " if type(error) is KeyError else ""
        why = (str(error) or type(error).__name__).splitlines()[0][:MAX_CHARACTERS]
        raise CophyError(
            f"{source} is no checkpoint of train.py, or of another version of cophy ({what}{why}): take another, or "
            "train again"
        ) from error
