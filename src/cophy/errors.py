"""The exception for mistakes of the user, whose message is printed in one line, and text that is safe to print."""

import re

SAFE = "finished runs, shards and last checkpoints are safe; free some space and run the same command to continue"

_NAME = re.compile(r"[A-Za-z0-9][\w.-]*", re.ASCII)


class CophyError(Exception):
    """An error that the user can fix: its message names the file or key, and the remedy."""


def check_name(key: str, name: str) -> None:
    """Refuse a name that cannot be part of a path: data and runs are stored in folders with such names.

    Raises:
        ValueError: It has characters other than letters, digits, dot, dash and underscore.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"{key}={name}: a name has letters, digits, '.', '-' and '_', and begins with one of the first two"
        )


def printable(text: str) -> str:
    """Return a text whose control characters, except line breaks, and lone surrogates are escaped: no terminal obeys them."""
    return "".join(
        character if character.isprintable() or character == "\n" else character.encode("unicode_escape").decode()
        for character in text
    )
