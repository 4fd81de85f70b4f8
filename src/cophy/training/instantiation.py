"""Objects and functions that keys of the configuration name by `_target_`."""

import inspect
from collections.abc import Callable
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
            raise CophyError(f"{key} needs another package, or its folder on PYTHONPATH: {cause}") from error
        raise CophyError(f"{key}: {cause or error}") from error


def instantiate_function(key: str, arguments: dict[str, Any]) -> Callable[..., Any]:
    """Return the function of two arguments that `_target_` names: an object of a class, or a function.

    Raises:
        CophyError: There is no such function, or it does not take the other keys; the message begins with `key`.
    """
    if "_target_" not in arguments:
        raise CophyError(f"{key} has no _target_, which names a function or a class")
    part = instantiate_key(key, arguments, _partial_=True)
    try:
        function: Callable[..., Any] = part() if isinstance(part.func, type) else part
        inspect.signature(function).bind(None, None)
    except (TypeError, ValueError) as error:
        raise CophyError(f"{key}: {error}; see {arguments['_target_']}") from error
    return function
