"""A network from the name of its class and its arguments (conf/model/)."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import torch
from hydra.errors import InstantiationException
from hydra.utils import get_class, instantiate
from torch import Tensor, nn

from cophy.errors import CophyError

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
