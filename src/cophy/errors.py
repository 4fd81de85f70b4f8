"""The one exception whose message is meant for the person at the terminal, and what a full disk leaves."""

SAFE = "finished runs, shards and last checkpoints are safe; free some, and the same command goes on"


class CophyError(Exception):
    """Something the user can mend: its message names the file or key, and the remedy."""
