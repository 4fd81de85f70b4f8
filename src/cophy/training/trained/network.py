"""A network from the name of its class and its arguments (conf/model/)."""

from collections.abc import Mapping
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import get_class, instantiate
from torch import nn

from cophy.errors import CophyError


def build_network(model: Mapping[str, Any]) -> nn.Module:
    """The network that `model._target_` names, made from the remaining keys as plain values.

    Nothing nested is made into an object: `model` may come from a checkpoint that somebody else wrote.

    Raises:
        CophyError: The class cannot be imported, is no torch module, or does not take these arguments.
    """
    target, arguments = model.get("_target_"), {key: value for key, value in model.items() if key != "_target_"}
    if target is None:
        raise CophyError("model._target_ is missing: it names the class of the model")
    if special := [key for key in arguments if key.startswith("_")]:
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


def _class_named(target: str) -> type:
    try:
        return get_class(target)
    except Exception as error:
        package = target.split(".")[0]
        unknown = isinstance(cause := error.__cause__, ModuleNotFoundError) and cause.name == package
        why = f"no module {package} (is its folder on PYTHONPATH?)" if unknown else " ".join(str(error).split())
        raise CophyError(f"model._target_={target} cannot be imported: {why}") from error
