"""Objects and functions that keys of the configuration name by `_target_`."""

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import instantiate

from cophy.errors import CophyError


def instantiate_key(key: str, arguments: dict[str, Any], **more: Any) -> Any:
    """Build what `_target_` names, with the other keys as its arguments.

    Raises:
        CophyError: It cannot be imported or built; the message begins with `key`.
    """
    try:
        return instantiate(arguments, **more)
    except InstantiationException as error:
        cause = error.__cause__
        if isinstance(cause, ModuleNotFoundError):
            raise CophyError(f"{key} needs another package: {cause}") from error
        message = " ".join(str(cause or error).split())
        hint = " Is its folder on PYTHONPATH?" if "that module" in message else ""
        raise CophyError(f"{key}: {message}{hint}") from error


def instantiate_function(key: str, arguments: dict[str, Any]) -> Callable[..., Any]:
    """Return the function of two arguments that `_target_` names: an object of a class, or a function.

    Raises:
        CophyError: There is no such function, or it does not take the other keys; the message begins with `key`.
    """
    if "_target_" not in arguments:
        raise CophyError(f"{key} has no _target_, which names a function or a class")
    part = instantiate_key(key, arguments, _partial_=True)
    try:
        if isinstance(part.func, type):
            instance: Callable[..., Any] = part()
            return instance
        inspect.signature(part.func).bind(None, None, **part.keywords)
    except TypeError as error:
        raise CophyError(f"{key}: {error}; see {arguments['_target_']}") from error
    except ValueError as error:
        if isinstance(part.func, type):
            raise
        raise CophyError(f"{key}: {error}; wrap {arguments['_target_']} in a Python function") from error
    return partial(part.func, **part.keywords)  # Hydra's own partial checks every call
