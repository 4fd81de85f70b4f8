"""Errors a user can mend, in one line: what is wrong, where, and the nearest right spelling."""

import os
import re
import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from typing import Any

from hydra.errors import HydraException, MissingConfigException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from cophy.errors import CophyError


def run(main: Callable[[], Any]) -> None:
    """Run a Hydra main; what the user can mend ends the process with one line, anything else with its traceback."""
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # let errors come here whole instead of being printed by Hydra
    try:
        main()
    except Exception as error:
        if not is_mendable(error):
            raise
        sys.exit(f"{sys.argv[0]}: {explain(error)}")
    except KeyboardInterrupt:
        sys.exit(f"{sys.argv[0]}: interrupted; finished shards and checkpoints are kept")


def is_mendable(error: Exception) -> bool:
    """Whether one line is enough for who runs the command; of all else, who wrote it needs the traceback."""
    of_a_file = isinstance(error, OSError) and error.filename is not None
    return of_a_file or isinstance(error, HydraException | OmegaConfBaseException | CophyError)


def to_config(config: Any) -> Any:
    """The typed, plain-Python configuration; ranges are checked while it is built."""
    try:
        return OmegaConf.to_object(config)
    except (ValueError, TypeError) as error:
        raise CophyError(str(error)) from error


def explain(error: BaseException) -> str:
    """One line for an error that is mendable."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    if row := re.match(
        r"In '(ablation|row)/(\w+)': \w+ raised while composing config:\s*(.*?)\s*(full_key|$)", str(error)
    ):
        if f"Key '{row[1]}' not in" in row[3]:
            return f"{row[1]}={row[2]}: its YAML must start with the line '# @package _global_'"
        return f"{row[1]}={row[2]} does not go with this model: {row[3]}"
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if isinstance(error, MissingConfigException) and error.options is not None and error.missing_cfg_file:
        group, _, name = error.missing_cfg_file.rpartition("/")
        choices = ", ".join(sorted(error.options))
        return f"{group}={name} does not exist{_suggest(name, error.options)}; there are {choices} (a folder of your own: --config-dir)"
    if isinstance(cause, OmegaConfBaseException) and cause.key is not None:
        what = (cause.msg or str(cause)).splitlines()[0]
        return f"{cause.full_key or cause.key}: {what}{_suggest(str(cause.key), _siblings(cause))}"
    return " ".join(lines)


def _siblings(error: OmegaConfBaseException) -> list[str]:
    node = error.parent_node
    return [str(key) for key in node] if OmegaConf.is_dict(node) else []


def _suggest(name: str, known: Sequence[str]) -> str:
    close = [match for match in get_close_matches(name, known, n=1) if match != name]
    return f" (did you mean {close[0]}?)" if close else ""
