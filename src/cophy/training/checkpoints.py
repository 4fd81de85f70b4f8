"""Whether a training may go on from a checkpoint, or be spared by one: only with the settings that its weights came from.

What a checkpoint says of itself: the plain values of a configuration, and not too many.
Checkpoints of train.py: written whole or not at all, and read without running code from them.
A network from the name of its class and its arguments (conf/model/).
"""

import io
import math
import pickle
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from hydra.errors import InstantiationException
from hydra.utils import get_class, instantiate
from lightning.fabric.plugins.io.checkpoint_io import CheckpointIO
from omegaconf.errors import OmegaConfBaseException
from torch import Tensor, nn

from cophy.atomic_files import write_atomically
from cophy.errors import CophyError

# ours: an origin has some 200 values, 4 levels deep, and no text that is longer than a path
MAX_VALUES, MAX_DEPTH, MAX_TEXT = 100_000, 10, 4096
MAX_BITS = 63


def check_plain(tree: Any) -> None:
    """Refuse what no configuration holds, such as other types, references, and what contains itself.

    Raises:
        ValueError: There is such a value; the message says which.
    """
    level = [tree]
    for _ in range(MAX_DEPTH):
        inner: list[Any] = []
        for value in level:
            inside = _inside(value)
            if len(inner) + len(inside) > MAX_VALUES:
                raise ValueError(f"it says more than {MAX_VALUES:,} values of itself")
            inner += inside
        if not inner:
            return
        level = inner
    raise ValueError(f"it says values of itself that are nested more than {MAX_DEPTH} deep, or contain themselves")


def _inside(value: Any) -> list[Any]:
    """What a value holds; only dictionaries and lists hold others."""
    if isinstance(value, dict):
        if odd := [key for key in value if not isinstance(key, str)]:
            raise ValueError(f"a key of {type(odd[0]).__name__} is no name")
        return [*value, *value.values()]
    if isinstance(value, list):
        return value
    if isinstance(value, str):
        _check_text(value)
    elif value is not None and not isinstance(value, bool | int | float):
        raise ValueError(f"a {type(value).__name__} is no value of a configuration")
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is no finite number")
    elif isinstance(value, int) and value.bit_length() > MAX_BITS:
        raise ValueError(f"a number of {value.bit_length()} bits is too large")
    return []


def _check_text(text: str) -> None:
    if len(text) > MAX_TEXT or not text.isprintable():
        raise ValueError(f"a text of {len(text)} characters is too long, or not all of them can be printed")
    if "${" in text:  # OmegaConf would resolve it: to other keys, and to what the environment holds
        raise ValueError(f"{text} is a reference, whose value it has to say instead")


ORIGIN = "origin"  # the key under which a checkpoint says what it is
MAX_BYTES = 4 << 30  # ours: a predictor has a megabyte, the paper's de-renderer some hundred
OF_NETWORK = "network."  # how the names of the network's weights start
# classes and functions that earlier versions had elsewhere, as their checkpoints name them
MOVED = {
    "cophy.models.alongside.alongside.Alongside": "cophy.models.alongside.Alongside",
    "cophy.training.optimisation.constant": "cophy.training.settings.constant",
    "cophy.training.optimisation.cosine_to_zero": "cophy.training.settings.cosine_to_zero",
}
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
        origin = Origin(**_with_todays_names(said))
    network = {key.removeprefix(OF_NETWORK): value for key, value in of_network.items()}
    return Checkpoint(origin, network, has_optimizer="optimizer_states" in saved)


def _with_todays_names(tree: Any) -> Any:
    """Replace every `_target_` of an earlier version by the name that it has today."""
    if not isinstance(tree, dict):
        return tree
    return {
        key: MOVED.get(value, value) if key == "_target_" and isinstance(value, str) else _with_todays_names(value)
        for key, value in tree.items()
    }


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


MOST = 1 << 14  # ours: layers as wide as this do not fit into a checkpoint of 4 GiB, and nothing is so deep


def build_network(model: Mapping[str, Any]) -> nn.Module:
    """The network that `model._target_` names, made from the remaining keys as plain values.

    Nothing nested is made into an object: `model` may come from a checkpoint that somebody else wrote.

    Raises:
        CophyError: The class cannot be imported, is no torch module, or does not take these arguments.
    """
    target, arguments = model.get("_target_"), {key: value for key, value in model.items() if key != "_target_"}
    if target is None:
        raise CophyError("model._target_ is missing: it names the class of the model")
    if special := [key for key in arguments if not isinstance(key, str) or key.startswith("_")]:
        raise CophyError(f"model.{special[0]} is no argument of a network")
    if not issubclass(_class_named(str(target)), nn.Module):
        raise CophyError(f"model._target_={target} is not a torch.nn.Module")
    try:
        return instantiate({"_target_": target}, **arguments, _recursive_=False, _convert_="all")
    except InstantiationException as error:
        if isinstance(error.__cause__, TypeError):
            raise CophyError(f"model: {error.__cause__}; see {target}") from error
        if isinstance(error.__cause__, MemoryError | RuntimeError) and "memory" in str(error.__cause__).lower():
            raise CophyError(f"model: there is no memory for a network of this size; see {target}") from error
        raise error.__cause__ or error from None


def restore_network(model: Mapping[str, Any], weights: Mapping[str, Tensor]) -> nn.Module:
    """The network of a checkpoint, one of cophy.models, with its weights.

    It takes no more memory than the checkpoint, unless its class needs values to be made.

    Raises:
        CophyError: The weights are not those of this network as it is now.
        RuntimeError: Likewise, of such a class.
    """
    for key, value in model.items():
        if isinstance(value, int) and value > MOST:
            raise CophyError(f"model.{key}={value} is more than {MOST}")
    check_shapes(model, weights)
    if sum(map(_num_bytes, weights.values())) > 2 * _num_bytes_held(weights):  # a few may be shared
        raise CophyError("its weights repeat a few numbers")
    network = build_network(model)
    network.load_state_dict(weights)
    return network


def check_shapes(model: Mapping[str, Any], weights: Mapping[str, Tensor]) -> None:
    """Compare names and shapes of weights with those of a network that holds no numbers (`meta`), if its class can be so.

    Raises:
        CophyError: They are not those of this network as it is now.
    """
    shapes = {key: value.shape for key, value in weights.items()}
    with suppress(RuntimeError), torch.device("meta"):
        wanted = {key: value.shape for key, value in build_network(model).state_dict().items()}
        if differing := sorted(key for key in wanted.keys() | shapes.keys() if wanted.get(key) != shapes.get(key)):
            raise CophyError(f"{differing[0]} does not fit {model['_target_']} as it is now")


def _num_bytes(weight: Tensor) -> int:
    return weight.numel() * weight.element_size()


def _num_bytes_held(weights: Mapping[str, Tensor]) -> int:
    """What lies in memory: of an expanded tensor one number, of one on `meta` nothing."""
    storages = [weight.untyped_storage() for weight in weights.values() if not weight.is_meta]
    return sum({storage.data_ptr(): storage.nbytes() for storage in storages}.values())


def _class_named(target: str) -> type:
    try:
        return get_class(target)
    except Exception as error:
        package = target.split(".")[0]
        unknown = isinstance(cause := error.__cause__, ModuleNotFoundError) and cause.name == package
        why = f"no module {package} (is its folder on PYTHONPATH?)" if unknown else " ".join(str(error).split())
        raise CophyError(f"model._target_={target} cannot be imported: {why}") from error


NAMED = 3  # settings in a message
CHOSEN = ("scenario", "size")  # by a name, which brings all other keys below it
NO_SETTING = {"scenario.task.splits"}  # names of splits: a split more changes no training
MAY_CHANGE = {  # where a training goes on: how long it is, how it is validated, and whether it is a trial
    *("trainer.max_epochs", "trainer.max_time", "split.epochs_factor", "trainer.fast_dev_run"),
    *("trainer.limit_val_batches", "trainer.check_val_every_n_epoch"),
}


def check_resumable(ckpt: Path, origin: Origin) -> None:
    """Refuse a checkpoint of another training. The resumed one may be longer.

    Args:
        ckpt: The checkpoint to go on from; reading it runs no code.
        origin: What is to be trained.

    Raises:
        CophyError: It is no checkpoint, or of another training (the message names the keys that differ), or its weights do
            not fit.
    """
    checkpoint = _read(ckpt, "ckpt", "last.ckpt")
    if not checkpoint.has_optimizer:
        raise CophyError(f"ckpt={ckpt} holds weights alone, for tests and predictions: go on from the run's last.ckpt")
    says_all = checkpoint.origin.seed is not None  # as earlier versions did not
    depends_on = _all_weights_depend_on if says_all else _weights_depend_on
    own, wanted = depends_on(checkpoint.origin), depends_on(origin)
    if keys := _differing(*({key: each[key] for key in each.keys() - MAY_CHANGE} for each in (own, wanted))):
        raise CophyError(f"ckpt={ckpt} is of another training ({keys}): go on with the same settings, or start anew")
    _check_weights(ckpt, checkpoint)


def check_trained(predictor: Path, origin: Origin) -> None:
    """Refuse a checkpoint whose weights are not those that this training would end with.

    Args:
        predictor: The checkpoint to test instead of training; reading it runs no code.
        origin: What would be trained.

    Raises:
        CophyError: It is no checkpoint, too old to tell, or of another training (the message names the keys that differ), or
            its weights do not fit.
    """
    checkpoint = _read(predictor, "predictor", "best.ckpt")
    own = checkpoint.origin
    if own.seed is None:
        raise CophyError(
            f"predictor={predictor} does not say with which seed it was trained, as earlier versions did not"
        )
    if keys := _differing(_all_weights_depend_on(own), _all_weights_depend_on(origin)):
        raise CophyError(f"predictor={predictor} is of another training ({keys}): test it with the same settings")
    _check_weights(predictor, checkpoint)


def flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Leaves of nested dictionaries under dotted names."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return leaves


def _read(path: Path, key: str, kept: str) -> Checkpoint:
    if not path.is_file():
        raise CophyError(f"{key}={path} is no file: a run keeps {kept} in its checkpoints/")
    return read_checkpoint(read_bytes(path), path)


def _check_weights(source: Path, checkpoint: Checkpoint) -> None:
    """Refuse those that do not fit the class of the model as it is now; its arguments are the same."""
    with made_from(source):
        check_shapes(checkpoint.origin.model, checkpoint.weights)


def _differing(trained: dict[str, Any], wanted: dict[str, Any]) -> str:
    """The settings of a checkpoint that are not those wanted, as a command line has them; of many, the first."""
    keys = [key for key in sorted(trained.keys() | wanted.keys()) if trained.get(key) != wanted.get(key)]
    chosen = [group for group in CHOSEN if f"{group}.name" in keys]
    others = [key for key in keys if key.split(".")[0] not in (*chosen, "data")]
    if not chosen and not others:
        others = keys  # data alone, which else follow from the settings
    named = [f"{group}={trained[f'{group}.name']}" for group in chosen]
    named += [f"{key}={trained.get(key)}" for key in others]
    more = [f"and {len(named) - NAMED} others"] if len(named) > NAMED else []
    return ", ".join(named[:NAMED] + more)


def _all_weights_depend_on(origin: Origin) -> dict[str, Any]:
    """Also what earlier versions did not write down."""
    last = {"seed": origin.seed, "trainer": origin.trainer, "split.epochs_factor": origin.split.get("epochs_factor")}
    return _weights_depend_on(origin) | flatten(last)


def _weights_depend_on(origin: Origin) -> dict[str, Any]:
    parts = {
        "scenario": origin.scenario,
        "split.train": origin.split.get("train"),
        "model": origin.model,
        "training": origin.training,
        "data_seed": origin.data_seed,
        "size": origin.size,
        "data": origin.trained_on,
    }
    return {key: value for key, value in flatten(parts).items() if key not in NO_SETTING}
