"""Checkpoints of train.py: written whole or not at all, read without running code from them, compared with a configuration.

A checkpoint stores under the key `origin` the configuration of its training as plain values (`make_origin`). It may come
from anybody: its size is limited, its checksums are compared, and its values are checked before anything is built from them.
"""

import importlib
import inspect
import io
import pickle
import zipfile
import zlib
from collections.abc import Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any

import lightning as L
import torch
from lightning.fabric.plugins.io.checkpoint_io import CheckpointIO
from torch import Tensor, nn

from cophy.atomic_files import write_atomically
from cophy.dataset.spec import FORMAT_VERSION
from cophy.errors import CophyError
from cophy.training.losses import MSE
from cophy.training.run import NO_RESULT, flatten

ORIGIN = "origin"  # the key of a checkpoint for the configuration of its training
KEYS: dict[str, tuple[type, ...]] = {  # of an origin, with their types
    **dict.fromkeys(("model", "training", "scenario", "split", "size", "render"), (dict,)),
    "data_seed": (int,),
    "positions": (str,),
    "num_objects": (list, NoneType),
    "trained_on": (list,),
    "seed": (int,),
    "trainer": (dict,),
    "source": (dict,),
    "format": (int,),
}
# that checkpoints of earlier formats lack, which are refused
LATER_KEYS: dict[str, Any] = {"seed": 0, "trainer": {}, "source": {"name": "generated"}, "format": 3}
# what Lightning restores from a checkpoint, beside the states of callbacks that name no paths; all else is dropped
RESTORED = ("state_dict", "loops", "optimizer_states", "lr_schedulers", "MixedPrecision")
MAX_CHECKPOINT_BYTES = 4 << 30  # ours: a predictor has a megabyte, the paper's de-renderer some hundred
MAX_VALUES, MAX_DEPTH = 100_000, 10  # ours: an origin has some 200 values, 4 levels deep
MAX_SIZE = 1 << 14  # ours: layers as wide as this do not fit into a checkpoint of 4 GiB, and nothing is so deep
NETWORK = "network."  # prefix of the names of the network's weights
MODELS = "cophy.models."  # the only modules that are imported because a checkpoint names them
# what torch raises for bytes that are no checkpoint
LOADING_ERRORS = (
    *(ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError),
    *(pickle.UnpicklingError, EOFError, MemoryError),
)
DATA = (NoneType, bool, int, float, complex, str, bytes, torch.dtype, torch.device)  # beside tensors and containers
NO_EFFECT = {*NO_RESULT, "trainer.limit_test_batches"}  # on weights; the devices of a training only change rounding
MAY_CHANGE = {  # when a training continues
    *("trainer.max_epochs", "trainer.max_time", "split.epochs_factor", "trainer.fast_dev_run"),
    *("trainer.limit_val_batches", "trainer.check_val_every_n_epoch"),
}
GROUPS = ("scenario", "size")  # named in messages by their choice instead of each key
MAX_NAMED = 3  # settings in a message


@dataclass(frozen=True)
class Checkpoint:
    """Contents of a checkpoint: origin, weights of the network, and whether a training can continue from it."""

    origin: dict[str, Any]
    weights: dict[str, Tensor]
    has_optimizer: bool


class WholeCheckpoints(CheckpointIO):
    """Writes checkpoints whole or not at all, reads local files only, and removes nothing but a run's own checkpoints.

    Lightning's own class writes through /tmp, where a full disk truncates, and opens the addresses that a checkpoint names.

    Args:
        origin: Stored in every checkpoint.
        directory: The run's checkpoints, the only files that may be removed.
        callbacks: Keys of the callbacks whose states are restored. Not those of ModelCheckpoint: they name paths.
    """

    def __init__(self, origin: dict[str, Any], directory: Path, callbacks: Set[str] = frozenset()) -> None:
        self.origin, self.directory, self.callbacks = origin, directory, callbacks

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        content = io.BytesIO()
        torch.save(checkpoint | {ORIGIN: self.origin}, content)
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(Path(path), content.getvalue())

    def load_checkpoint(self, path: Any, map_location: Any = None, weights_only: bool | None = None) -> dict[str, Any]:
        """Return what is restored from a checkpoint, and nothing else."""
        saved = _load(read_file(Path(path)), Path(path), map_location)
        states = saved.get("callbacks", {})
        if not isinstance(states, dict):
            raise CophyError(f"{path} is not a checkpoint of train.py")
        return {
            **{key: saved[key] for key in RESTORED if key in saved},
            "callbacks": {key: states[key] for key in self.callbacks & states.keys()},
            "pytorch-lightning_version": L.__version__,  # nothing to migrate
        }

    def remove_checkpoint(self, path: Any) -> None:
        path = Path(path)
        if path.suffix == ".ckpt" and path.parent.resolve() == self.directory.resolve():
            path.unlink(missing_ok=True)


def make_origin(config: Mapping[str, Any], trained_on: list[Any]) -> dict[str, Any]:
    """Return what every checkpoint stores about its training.

    Args:
        config: The resolved configuration of train.py as plain values.
        trained_on: Everything that the training batches are a function of, as the datamodule states it.
    """
    trainer = {key: value for key, value in config["trainer"].items() if f"trainer.{key}" not in NO_EFFECT}
    keys = [key for key in KEYS if key not in ("trainer", "trained_on", "format")]
    values = {key: config[key] for key in keys}
    values["source"] = {"name": config["source"]["name"]}  # without paths of this machine
    return {**values, "trainer": trainer, "trained_on": trained_on, "format": FORMAT_VERSION}


def read_file(path: Path) -> bytes:
    """Read the file of a checkpoint, if it is one that is not too large."""
    if not path.is_file():
        raise CophyError(
            f"{path} is not a file: name a checkpoint of train.py, for example outputs/.../checkpoints/best.ckpt"
        )
    if path.stat().st_size > MAX_CHECKPOINT_BYTES:
        raise CophyError(f"{path} is not a checkpoint of train.py: it is larger than {MAX_CHECKPOINT_BYTES >> 30} GiB")
    return path.read_bytes()


def read_checkpoint(content: bytes, source: Path) -> Checkpoint:
    """Read the content of a checkpoint file.

    Raises:
        CophyError: It was not written by train.py, or is damaged; the message names `source`.
    """
    saved = _load(content, source, "cpu")
    origin, weights = saved.get(ORIGIN), saved.get("state_dict")
    if not isinstance(weights, dict) or not all(
        isinstance(key, str) and isinstance(weight, Tensor) for key, weight in weights.items()
    ):
        raise CophyError(f"{source} is not a checkpoint of train.py: it has no weights")
    network = {key.removeprefix(NETWORK): value for key, value in weights.items() if key.startswith(NETWORK)}
    return Checkpoint(_check_origin(origin, source), network, has_optimizer="optimizer_states" in saved)


def _load(content: bytes, source: Path, map_location: Any) -> dict[str, Any]:
    """Compare the checksums (CRC-32) that torch stores but does not compare, and load; torch does not compress."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            size = sum(each.file_size for each in entries)
            if any(each.compress_type != zipfile.ZIP_STORED for each in entries) or size > len(content):
                raise CophyError(f"{source} is not a checkpoint of train.py: it is compressed, or its parts overlap")
            damaged = archive.testzip()
        if damaged is not None:
            raise CophyError(f"{source} is damaged (checksum of {damaged}): use another copy, or train again")
        saved = torch.load(io.BytesIO(content), map_location=map_location, weights_only=True)
        _check_data(saved)
    except (*LOADING_ERRORS, zipfile.BadZipFile, OSError, zlib.error) as error:
        raise CophyError(f"{source} is not a checkpoint of train.py, or is damaged ({_first_line(error)})") from error
    if not isinstance(saved, dict):
        raise CophyError(f"{source} is not a checkpoint of train.py")
    return saved


def _check_data(tree: Any) -> None:
    """Check that a loaded file holds data, no functions or classes, and tensors that are stored in full.

    Raises:
        ValueError: It does not.
    """
    values, seen, tensors = [tree], set(), []
    while values:
        value = values.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, Tensor):
            tensors.append(value)
        elif isinstance(value, dict):
            values += [*value, *value.values()]
        elif isinstance(value, list | tuple | set):
            values += value
        elif not isinstance(value, DATA):
            raise ValueError(f"{type(value).__name__} is not a type of data")
    if sum(map(_num_bytes, tensors)) > 2 * _num_stored_bytes(tensors):  # a few may be shared
        raise ValueError("its tensors repeat a few numbers")


def _num_bytes(tensor: Tensor) -> int:
    return tensor.numel() * tensor.element_size()


def _num_stored_bytes(tensors: list[Tensor]) -> int:
    """Count bytes in memory: one number for an expanded tensor, nothing for one on `meta`."""
    storages = [tensor.untyped_storage() for tensor in tensors if not tensor.is_meta]
    return sum({storage.data_ptr(): storage.nbytes() for storage in storages}.values())


def _check_origin(origin: Any, source: Path) -> dict[str, Any]:
    """Return an origin after a check of its keys, types and size."""
    try:
        check_plain_values(origin)
        if not isinstance(origin, dict):
            raise ValueError("no origin")
        origin = origin if "format" in origin else LATER_KEYS | origin
        if unknown := origin.keys() ^ KEYS.keys():
            raise ValueError(f"key {min(unknown)} is missing or unknown")
        for key, types in KEYS.items():
            if not isinstance(origin[key], types):
                raise ValueError(f"{key} is of type {type(origin[key]).__name__}")
        for group, key in (("model", "_target_"), ("scenario", "name"), ("split", "name")):
            if not isinstance(origin[group].get(key), str):
                raise ValueError(f"{group}.{key} is not a name")
        if not all(map(str.isidentifier, origin["model"]["_target_"].split("."))):
            raise ValueError("model._target_ is not the name of a class")
    except ValueError as error:
        raise misfit(source, error) from error
    origin["training"] = {"loss": MSE} | origin["training"]
    if origin["source"].get("name") == "generated" and origin["format"] != FORMAT_VERSION:
        raise CophyError(
            f"{source} was trained by an earlier version (data of format {origin['format']}, now {FORMAT_VERSION}): "
            "train it again (docs/reference/upgrading.md)"
        )
    return dict(origin)


def check_plain_values(tree: Any) -> None:
    """Check that a tree holds only what a configuration holds: few plain values without references.

    Raises:
        ValueError: It does not; the message says what was there.
    """
    level = [tree]
    for _ in range(MAX_DEPTH):
        children: list[Any] = []
        for value in level:
            if isinstance(value, dict | list):
                if len(children) + 2 * len(value) > MAX_VALUES:
                    raise ValueError(f"more than {MAX_VALUES:,} values")
                children += [*value, *value.values()] if isinstance(value, dict) else value
            if isinstance(value, dict) and not all(isinstance(key, str) for key in value):
                raise ValueError("a key is not a name")
            if value is not None and not isinstance(value, dict | list | str | bool | int | float):
                raise ValueError(f"{type(value).__name__} is not a type of a configuration's values")
            if isinstance(value, str) and "${" in value:  # OmegaConf would resolve it, to environment variables too
                raise ValueError(f"{value[:80]!r} is a reference")
        if not children:
            return
        level = children
    raise ValueError(f"values are nested more than {MAX_DEPTH} deep, or contain themselves")


def misfit(source: Path, error: Exception) -> CophyError:
    """Return the error to raise for a checkpoint whose contents do not fit what is built from them."""
    return CophyError(
        f"{source} was not written by train.py, or by another version of cophy ({_first_line(error)}): use another "
        "checkpoint, or train again"
    )


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:300]


def build_network(model: Mapping[str, Any], network_class: type[nn.Module] | None = None) -> nn.Module:
    """Build the network that `model._target_` names, or an object of a given class, with the remaining keys as its arguments.

    Nested values stay plain: nothing in them is built, as `model` may come from a checkpoint.

    Raises:
        CophyError: The class cannot be found, is not a torch module, or does not take these arguments.
    """
    target, arguments = model.get("_target_"), {key: value for key, value in model.items() if key != "_target_"}
    if target is None:
        raise CophyError("model._target_ is missing: it names the class of the model")
    if special := [key for key in arguments if not isinstance(key, str) or key.startswith("_")]:
        raise CophyError(f"model.{special[0]} is not an argument of a network")
    network_class = network_class or import_network_class("model._target_", str(target))
    try:
        inspect.signature(network_class).bind(**arguments)
    except TypeError as error:
        raise CophyError(f"model: {error}; see {target}") from error
    try:
        return network_class(**arguments)
    except (MemoryError, RuntimeError) as error:
        if "memory" not in str(error).lower():
            raise
        raise CophyError(f"model: not enough memory for a network of this size; see {target}") from error


def import_network_class(key: str, target: str) -> type[nn.Module]:
    """Import the class of a network that a key of the configuration names.

    Raises:
        CophyError: There is no such class.
    """
    module, _, name = target.rpartition(".")
    try:
        value = getattr(importlib.import_module(module), name, None)
    except (ModuleNotFoundError, ValueError) as error:
        missing = getattr(error, "name", None) or ""
        if module and not f"{module}.".startswith(f"{missing}."):  # a module of the user imports something missing
            raise
        hint = f"no module {missing or module} (is its folder on PYTHONPATH?)"
        raise CophyError(f"{key}={target} cannot be imported: {hint}") from error
    if value is None:
        raise CophyError(f"{key}={target} cannot be imported: {module} has no {name}")
    if not (isinstance(value, type) and issubclass(value, nn.Module)):
        raise CophyError(f"{key}={target} is not a torch.nn.Module")
    return value


def restore_network(checkpoint: Checkpoint, source: Path, network_class: type[nn.Module] | None = None) -> nn.Module:
    """Build the network of a checkpoint with its weights.

    Args:
        checkpoint: Of a class of cophy.models, whose shapes are compared on the meta device, before memory is allocated; or of
            `network_class`.
        network_class: A class of the user, which the user named: a checkpoint never decides what is imported.

    Raises:
        CophyError: It is of another class, the weights do not fit this network as it is now, or its arguments are not those of
            its class.
    """
    model, weights = checkpoint.origin["model"], checkpoint.weights
    target = model["_target_"]
    if network_class is not None and target.rpartition(".")[2] != network_class.__name__:  # its file may have moved
        raise CophyError(f"{source} is a checkpoint of {target}, not of model_class={network_class.__name__}")
    if network_class is None and not target.startswith(MODELS):
        raise CophyError(
            f"{source} is a checkpoint of {target}, whose code runs only if you name it: append model_class={target}"
        )
    try:
        if network_class is None:
            for key, value in model.items():
                if isinstance(value, int) and value > MAX_SIZE:
                    raise ValueError(f"model.{key}={value} is more than {MAX_SIZE}")
            with torch.device("meta"):
                _check_shapes(weights, build_network(model), target)
        network = build_network(model, network_class).float()  # whatever the caller's default is
        _check_shapes(weights, network, target)
        network.load_state_dict(weights)
    except (CophyError, AssertionError, RuntimeError, TypeError, ValueError) as error:  # constructors of networks
        raise misfit(source, error) from error
    return network


def _check_shapes(weights: Mapping[str, Tensor], network: nn.Module, target: str) -> None:
    """Raise ValueError with the first name whose weight is missing, unknown, or of another shape."""
    shapes, expected = (
        {key: each.shape for key, each in tensors.items()} for tensors in (weights, network.state_dict())
    )
    for name in sorted(shapes.keys() | expected.keys()):
        if shapes.get(name) != expected.get(name):
            raise ValueError(f"{name} does not fit {target} as it is now")


def check_resumable(ckpt: Path, origin: dict[str, Any], network: nn.Module) -> None:
    """Check that a training can continue from a checkpoint: the same settings; it may be longer.

    Args:
        origin: Origin of the training that continues.

    Raises:
        CophyError: It is not a checkpoint, or of another training (the message names the keys that differ), or its weights
            do not fit.
    """
    checkpoint = _read(ckpt, "ckpt", "last.ckpt")
    if not checkpoint.has_optimizer:
        raise CophyError(f"ckpt={ckpt} holds only weights, for tests and predictions: use the run's last.ckpt")
    if keys := _differing(_lasting_settings(checkpoint.origin), _lasting_settings(origin)):
        raise CophyError(
            f"ckpt={ckpt} belongs to another training ({keys}): use the same settings, or train from scratch"
        )
    _check_weights(ckpt, checkpoint, network)


def is_of_one_training(*checkpoints: Path) -> bool:
    """Return whether two checkpoints are of one training, or of a shorter and a longer one."""
    return not _differing(*(_lasting_settings(read_checkpoint(read_file(each), each).origin) for each in checkpoints))


def check_trained(predictor: Path, origin: dict[str, Any], network: nn.Module) -> None:
    """Check that a checkpoint holds the weights that a training would end with.

    Args:
        predictor: The checkpoint to test instead of training.
        origin: Origin of that training.

    Raises:
        CophyError: It is not a checkpoint, or of another training (the message names the keys that differ), or its weights
            do not fit.
    """
    checkpoint = _read(predictor, "predictor", "best.ckpt")
    if keys := _differing(_settings(checkpoint.origin), _settings(origin)):
        raise CophyError(f"predictor={predictor} belongs to another training ({keys}): use the same settings")
    _check_weights(predictor, checkpoint, network)


def _read(path: Path, key: str, name: str) -> Checkpoint:
    if not path.is_file():
        raise CophyError(f"{key}={path} is not a file: a run keeps {name} in its checkpoints/")
    return read_checkpoint(read_file(path), path)


def _check_weights(source: Path, checkpoint: Checkpoint, network: nn.Module) -> None:
    try:
        _check_shapes(checkpoint.weights, network, checkpoint.origin["model"]["_target_"])
    except ValueError as error:
        raise misfit(source, error) from error


def _settings(origin: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that weights depend on, under dotted names."""
    groups = {key: origin[key] for key in ("scenario", "model", "training", "data_seed", "size", "seed", "trainer")}
    groups |= {f"split.{key}": origin["split"].get(key) for key in ("train", "epochs_factor")}
    groups["data"] = origin["trained_on"]
    return {key: value for key, value in flatten(groups).items() if key not in NO_EFFECT}


def _lasting_settings(origin: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that stay when a training continues."""
    return {key: value for key, value in _settings(origin).items() if key not in MAY_CHANGE}


def _differing(stored: dict[str, Any], wanted: dict[str, Any]) -> str:
    """List the settings of a checkpoint that differ from those wanted, as a command line has them; at most MAX_NAMED."""
    keys = [key for key in sorted(stored.keys() | wanted.keys()) if stored.get(key) != wanted.get(key)]
    groups = [group for group in GROUPS if f"{group}.name" in keys]
    others = [key for key in keys if key.split(".")[0] not in (*groups, "data")]
    if not groups and not others:
        others = keys  # the data alone, which otherwise follow from the settings
    named = [f"{group}={stored.get(f'{group}.name')}" for group in groups]
    named += [f"{key}={stored.get(key)}" for key in others]
    more = [f"and {len(named) - MAX_NAMED} more"] if len(named) > MAX_NAMED else []
    return ", ".join(named[:MAX_NAMED] + more)
