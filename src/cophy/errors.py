"""The one exception whose message is meant for the person at the terminal."""


class CophyError(Exception):
    """Something the user can mend: its message names the file or key, and the remedy."""
