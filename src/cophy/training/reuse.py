"""Train once what several runs share, and continue what was interrupted.

3to3 and 3to4, for example, differ only in their test data. Beside its checkpoints a training stores a fingerprint: when it
begins (begun.json) and when it ends (finished.json). The fingerprint hashes the files of cophy that training imports, the
user's model with the modules beside it, the version of torch, the configuration that weights depend on, and the checksums
of the training data. The device is not part of it.
"""

import ast
import hashlib
import inspect
import json
import logging
import os
import shutil
import sys
from pathlib import Path
from typing import Any, NamedTuple

import torch

import cophy
from cophy.atomic_files import read_plain, sha256, write_atomically
from cophy.errors import CophyError
from cophy.training.checkpoints import read_bytes
from cophy.training.run import Run

log = logging.getLogger(__name__)

PACKAGE = Path(cophy.__file__).parent
FINISHED, BEGUN = "finished.json", "begun.json"
STOPPED = "last_of_stopped.ckpt"
KEYS = {FINISHED: {"fingerprint", "training_seconds", "validation", "resumed"}, BEGUN: {"fingerprint", "resumed"}}
PAIR = ("best.ckpt", "last.ckpt")
WITHOUT_EFFECT = {  # keys of `trainer` that are not part of the fingerprint
    *("enable_progress_bar", "enable_model_summary", "log_every_n_steps", "limit_test_batches", "profiler"),
    *("accelerator", "devices", "num_nodes", "strategy"),  # they only change rounding
}


class Start(NamedTuple):
    """How a training starts.

    Attributes:
        finished: Facts about an identical finished training, whose checkpoints are now this run's; None if there is none.
        checkpoint: Where training resumes, or the best checkpoint of the finished training; None for a new training.
        resumed: How often it was interrupted before.
    """

    finished: dict[str, Any] | None
    checkpoint: Path | None
    resumed: int


def hash_code(*objects: object) -> str:
    """Hash the source files that the classes of some objects import from cophy, and files beside classes of the user.

    Call it before data are generated, so that an edit in the meantime counts for the next command.
    """
    classes = [type(each) for each in objects]
    paths = set(imported_files({each.__module__ for each in classes if each.__module__.startswith("cophy.")}))
    for each in classes:
        source = inspect.getsourcefile(each)
        if source and PACKAGE not in Path(source).parents:
            paths |= set(Path(source).parent.glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(paths))).hexdigest()


def imported_files(modules: set[str]) -> list[Path]:
    """Return the files of some modules of cophy and of all that they import from cophy at module level."""
    files: dict[str, Path] = {}
    remaining = sorted(modules)
    while remaining:
        name = remaining.pop()
        if name not in files:
            files[name] = Path(str(sys.modules[name].__file__))
            remaining += _imports(ast.parse(files[name].read_bytes()))
    return sorted(files.values())


def _imports(tree: ast.Module) -> set[str]:
    """Return the modules of cophy that a file imports at module level, also through a package's `__init__`."""
    modules = set()
    for node in tree.body:
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules.add(str(node.module))
            for alias in node.names:
                value = getattr(sys.modules.get(str(node.module)), alias.name, None)
                modules |= {str(getattr(value, "__module__", None)), f"{node.module}.{alias.name}"}
    return {name for name in modules if name.split(".")[0] == "cophy" and name in sys.modules}


def fingerprint(
    origin: dict[str, Any],
    *,
    trainer: dict[str, Any],
    threads: int,
    code: str,
    checksums: dict[str, Any],
    resumed_from: Path | None = None,
) -> str:
    """Hash everything that the weights depend on.

    Args:
        origin: The configuration as stored in checkpoints.
        trainer: Arguments of `lightning.Trainer`.
        threads: Threads of torch.
        code: See `hash_code`.
        checksums: Checksums of the training data.
        resumed_from: The checkpoint of another training that this one starts from.
    """
    content = {
        **{key: origin[key] for key in ("trained_on", "model", "training", "seed")},
        "trainer": {key: value for key, value in trainer.items() if key not in WITHOUT_EFFECT},
        "threads": threads,
        "code": code,
        "torch": torch.__version__,
        "checksums": checksums,
        "resumed_from": sha256(resumed_from) if resumed_from else None,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def start_training(run: Run, wanted: str, *, reuse: bool, ckpt: Path | None) -> Start:
    """Find a finished or interrupted training with this fingerprint; otherwise make room for a new one.

    Args:
        run: The run.
        wanted: Fingerprint of its training.
        reuse: Whether earlier trainings are looked for.
        ckpt: The checkpoint (ckpt=) that the training starts from.
    """
    if reuse and (checkpoints := _find_finished(run, wanted)) is not None:
        log.info("already trained on the same data with the same settings: %s (reuse=false trains again)", checkpoints)
        return Start(_adopt(checkpoints, run), checkpoints / "best.ckpt", 0)
    last, stopped = run.checkpoints / "last.ckpt", _read(run.checkpoints, BEGUN)
    if reuse and stopped.get("fingerprint") == wanted and _is_complete(run.checkpoints):
        log.info("continues where it stopped: %s (reuse=false trains again)", last)
        resumed = stopped["resumed"] + 1
        _write(run.checkpoints, BEGUN, {"fingerprint": wanted, "resumed": resumed})
        return Start(None, last, resumed + (ckpt is not None))
    best = read_bytes(ckpt.with_name("best.ckpt")) if ckpt and ckpt.with_name("best.ckpt").is_file() else None
    is_last = ckpt is not None and last.exists() and ckpt.samefile(last)
    if last.exists() and (stopped or is_last):
        log.warning(
            "%s belongs to a training with other settings or code, or a shorter one: it is kept as %s; this one starts anew",
            *(last, last.with_name(STOPPED)),
        )
        os.replace(last, last.with_name(STOPPED))
    _remove_checkpoints(run)
    if best is not None:  # the best epoch so far may remain the best
        run.checkpoints.mkdir(parents=True, exist_ok=True)
        write_atomically(run.checkpoints / "best.ckpt", best)
    _write(run.checkpoints, BEGUN, {"fingerprint": wanted, "resumed": 0})
    return Start(None, last.with_name(STOPPED) if is_last else ckpt, int(ckpt is not None))


def record_finished(run: Run, wanted: str, facts: dict[str, Any]) -> None:
    """Store the fingerprint and facts of a finished training: training_seconds, resumed, validation."""
    _write(run.checkpoints, FINISHED, {"fingerprint": wanted, **facts})
    (run.checkpoints / BEGUN).unlink(missing_ok=True)


def _find_finished(run: Run, wanted: str) -> Path | None:
    """Return checkpoints of a finished training with this fingerprint: the run's own, or those of another split."""
    directories = [run.directory]
    if run.root is not None:
        scenario, _, model, ablation, _, seed = run.place.parts
        directories += sorted(run.root.glob(str(Path(scenario, "*", model, ablation, "*", seed))))
    for checkpoints in (directory / "checkpoints" for directory in directories):
        if _read(checkpoints, FINISHED).get("fingerprint") == wanted and _is_complete(checkpoints):
            return checkpoints
    return None


def _adopt(checkpoints: Path, run: Run) -> dict[str, Any]:
    """Copy finished checkpoints into the run and return the facts about their training."""
    if checkpoints.resolve() != run.checkpoints.resolve():
        _remove_checkpoints(run)
        run.checkpoints.mkdir(parents=True, exist_ok=True)
        for name in (*PAIR, FINISHED):
            shutil.copyfile(checkpoints / name, run.checkpoints / name)
    facts = _read(run.checkpoints, FINISHED)
    return {key: facts[key] for key in ("training_seconds", "resumed", "validation")}


def _remove_checkpoints(run: Run) -> None:
    for name in (FINISHED, BEGUN, *PAIR):
        (run.checkpoints / name).unlink(missing_ok=True)


def _is_complete(checkpoints: Path) -> bool:
    return all((checkpoints / name).is_file() for name in PAIR)


def _write(checkpoints: Path, name: str, content: dict[str, Any]) -> None:
    checkpoints.mkdir(parents=True, exist_ok=True)
    write_atomically(checkpoints / name, (json.dumps(content) + "\n").encode())


def _read(checkpoints: Path, name: str) -> dict[str, Any]:
    """Return what a training stored about itself; nothing if it stored nothing."""
    path = checkpoints / name
    try:
        content = json.loads(read_plain(path))
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise CophyError(f"{path} is damaged ({error}): delete it to train again") from error
    if not isinstance(content, dict) or not KEYS[name] <= content.keys():
        raise CophyError(f"{path} lacks {', '.join(sorted(KEYS[name]))}: delete it to train again")
    return content
