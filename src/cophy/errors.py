"""The one exception whose message is meant for the person at the terminal, and what a full disk leaves."""

import re

SAFE = "finished runs, shards and last checkpoints are safe; free some, and the same command goes on"


_NAME = re.compile(r"[A-Za-z0-9][\w.-]*", re.ASCII)


class CophyError(Exception):
    """Something the user can mend: its message names the file or key, and the remedy."""


def check_name(key: str, name: str) -> None:
    """Refuse a name that is no part of a path: data and runs lie in folders that are called by it.

    Raises:
        ValueError: It has other characters than letters, digits, dot, dash and underscore.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"{key}={name}: a name has letters, digits, '.', '-' and '_', and begins with one of the first two"
        )
