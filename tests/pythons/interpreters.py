"""Python interpreters of other versions on this machine."""

import os
import subprocess
from pathlib import Path
from shutil import which

VERSIONS = ("3.10", "3.11", "3.12", "3.13", "3.14")


def find(version: str) -> str | None:
    """Return the path of an interpreter of a version, from PATH or pyenv, or None."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    for path in (which(f"python{version}"), *pyenv.glob(f"versions/{version}.*/bin/python")):
        # a shim of pyenv fails unless its version is selected
        if path and subprocess.run([path, "--version"], capture_output=True, check=False).returncode == 0:
            return str(path)
    return None
