"""The commands, run as `python src/<name>.py` runs them, but in this process: seconds of imports are saved each time."""

import io
import logging
import os
import runpy
import subprocess
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from hydra._internal.hydra import Hydra
from hydra.core.hydra_config import HydraConfig

from tests.conftest import ROOT

ON_TWO = ("trainer.devices=2", "trainer.strategy=ddp", "trainer.accelerator=cpu")


def run(script: str, *arguments: object, code: int = 0) -> str:
    """Return what a command prints; its exit code has to be `code`."""
    ended, text = ending(script, *arguments)
    assert ended == code, text[-3000:]
    return text


def ending(script: str, *arguments: object) -> tuple[int, str]:
    """Return the exit code of a command, and what it prints."""
    printed = io.StringIO()
    with _restored(), redirect_stdout(printed), redirect_stderr(printed), _arguments(script, *arguments) as path:
        ended = 0
        try:
            runpy.run_path(path, run_name="__main__")
        except SystemExit as end:  # as the interpreter does
            ended = end.code if isinstance(end.code, int) else int(end.code is not None)
            printed.write(f"{end.code}\n" if isinstance(end.code, str) else "")
        except Exception:
            ended = 1
            traceback.print_exc(file=printed)
    return ended, printed.getvalue()


def run_apart(script: str, *arguments: object, code: int = 0) -> str:
    """Run a command in a process of its own, where that is what is tested."""
    done = python(ROOT / "src" / f"{script}.py", *arguments, code=code)
    return done.stdout + done.stderr


def python(
    *words: object, code: int = 0, env: Mapping[str, str] | None = None, **others: Any
) -> "subprocess.CompletedProcess[str]":
    """Run Python in a process of its own; its exit code has to be `code`.

    Args:
        env: More environment variables.
        others: `cwd` and `input`, as `subprocess.run` has them.
    """
    command, variables = [sys.executable, *map(str, words)], {**os.environ, **(env or {})}
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=600, check=False, **others)
    assert done.returncode == code, (done.stdout + done.stderr)[-3000:]
    return done


def train(*arguments: object, data: Path, code: int = 0, apart: bool = False) -> str:
    """A run on tiny data, with one epoch and without figures, which take longer than that, unless arguments say otherwise."""
    usual = {"trainer.max_epochs": "1", "logger": "[]"}
    keys = {str(argument).partition("=")[0] for argument in arguments}
    defaults = [f"{key}={value}" for key, value in usual.items() if key not in keys]
    return (run_apart if apart else run)("train", *arguments, "size=tiny", f"data_dir={data}", *defaults, code=code)


def without_times(metrics: dict[str, Any]) -> dict[str, Any]:
    """Return metrics.json without what may differ between two runs of the same command."""
    times = {"training_seconds", "training_cpu_seconds", "wall_seconds", "resumed"}
    return {key: value for key, value in metrics.items() if key not in times}


_read_mode = Hydra.get_mode


def _mode(hydra: Hydra, config_name: str | None, overrides: list[str]) -> Any:
    """Return the mode that -m decides, without a second composition to read hydra.mode; only +table= sets that."""
    return _read_mode(hydra, config_name, overrides) if any("+table=" in word for word in overrides) else None


@contextmanager
def _arguments(script: str, *arguments: object) -> Iterator[str]:
    path, before = str(ROOT / "src" / f"{script}.py"), (sys.argv, sys.path[:])
    sys.argv = [path, *map(str, arguments)]
    sys.path.insert(0, str(ROOT / "src"))
    try:
        yield path
    finally:
        sys.argv, sys.path[:] = before


@contextmanager
def _restored() -> Iterator[None]:
    """Undo what a command changes for the whole process."""
    logger = logging.getLogger()
    handlers, level = logger.handlers[:], logger.level
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a command continues
            with patch.object(Hydra, "get_mode", _mode):
                yield
    finally:
        for handler in logger.handlers:
            if handler not in handlers:  # the command's own
                handler.close()
        logger.handlers[:], logger.level = handlers, level
        torch.use_deterministic_algorithms(False)
        torch.set_num_threads(1)
        HydraConfig.instance().cfg = None
