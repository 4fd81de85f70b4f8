"""Train once what several runs share, and continue what was interrupted.

3to3 and 3to4, for example, differ only in their test data. Next to its checkpoints a training stores a fingerprint: when it
begins (begun.json) and when it ends (finished.json). A training with an equal fingerprint is the same training, on whatever
device.
"""

import ast
import hashlib
import inspect
import json
import logging
import os
import shutil
from collections.abc import Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn

import cophy
from cophy.atomic_files import read_json, sha256, write_atomically
from cophy.errors import CophyError
from cophy.training.checkpoints import is_of_one_training, read_file
from cophy.training.run import Run

log = logging.getLogger(__name__)

PACKAGE = Path(cophy.__file__).parent
MODELS = PACKAGE / "models"
CODE = ("scenario", "dataset", "training")  # the subpackages that weights depend on as a whole
LIBRARIES = {"torch", "lightning", "pytorch_optimizer"}  # whose code is not hashed
FINISHED, BEGUN = "finished.json", "begun.json"
STOPPED = {"last.ckpt": "last_of_stopped.ckpt", "best.ckpt": "best_of_stopped.ckpt"}  # of an interrupted training
NOTES: dict[str, dict[str, Any]] = {  # the types of what they hold
    FINISHED: {
        **dict.fromkeys(("fingerprint", "code"), str),
        **dict.fromkeys(("training_seconds", "training_cpu_seconds"), int | float),
        **{"validation": dict, "resumed": int},
    },
    BEGUN: {"fingerprint": str, "resumed": int},
}
PAIR = ("best.ckpt", "last.ckpt")


class Start(NamedTuple):
    """How a run starts.

    Attributes:
        finished: Facts about the training if there is nothing to train: what `trainer.fit` returns, and resumed.
        checkpoint: Where training resumes, or the checkpoint to test; None for a new training, or for no weights.
        resumed: How often the training was interrupted before.
        keeps_curves: Whether the curves in the run's folder belong to this training.
    """

    finished: dict[str, Any] | None
    checkpoint: Path | None
    resumed: int = 0
    keeps_curves: bool = False


def hash_code(*parts: object) -> str:
    """Hash the source that weights depend on.

    This is the code of the training, the model with all files of `cophy.models` that it or the training imports, and the files next
    to a model, loss, callback, optimiser or schedule of the user. Other models do not count, so an edit of one does not train the
    others again.

    Call it before data are generated, so that an edit in the meantime counts for the next command.
    """
    folders, modules = [PACKAGE / name for name in CODE], []
    for part in filter(None, parts):  # a de-renderer has no loss of positions
        written = inspect.unwrap(part.func) if isinstance(part, partial) else type(part)  # a decorator is elsewhere
        source = None if written.__module__.partition(".")[0] in LIBRARIES else inspect.getsourcefile(written)
        if source and PACKAGE not in Path(source).parents:
            folders.append(Path(source).parent)
        if isinstance(part, nn.Module):
            modules += [type(module).__module__ for module in part.modules()]
    paths = [PACKAGE / "types.py", *(path for folder in folders for path in sorted(folder.glob("*.py")))]
    paths += sorted(_models_among([*modules, *chain.from_iterable(map(_imports, paths))]))
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def _models_among(names: list[str]) -> set[Path]:
    """Return the files of `cophy.models` among the modules and objects with these dotted names, and those that they import."""
    found: set[Path] = set()
    while names:
        name = names.pop()
        path = MODELS / f"{name.removeprefix('cophy.models.').partition('.')[0]}.py"
        if name.startswith("cophy.models") and path not in found:
            # an object of the package itself may come from any of its files
            new = {path} if path.is_file() else set(MODELS.glob("*.py")) - found
            found |= new
            names += chain.from_iterable(map(_imports, new))
    return found


def _imports(path: Path) -> Iterator[str]:
    """Yield the dotted names that a file imports; none for a file next to a user's model that is no valid Python."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{each.name}" for each in node.names)
        elif isinstance(node, ast.Import):
            yield from (each.name for each in node.names)


def fingerprint(
    origin: dict[str, Any],
    *,
    max_epochs: int,
    threads: int,
    code: str,
    checksums: dict[str, Any],
    resumed_from: Path | None = None,
) -> str:
    """Hash everything that the weights depend on.

    Args:
        origin: The configuration as stored in checkpoints.
        code: See `hash_code`.
        checksums: Checksums of the training data.
        resumed_from: The checkpoint of another training that this one starts from.
    """
    content = {
        **{key: origin[key] for key in ("trained_on", "model", "training", "seed")},
        "trainer": origin["trainer"] | {"max_epochs": max_epochs},
        "threads": threads,
        "code": code,
        "torch": torch.__version__,
        "checksums": checksums,
        "resumed_from": sha256(resumed_from) if resumed_from else None,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def start_training(run: Run, wanted: str, *, reuse: bool, ckpt: Path | None, code: str) -> Start:
    """Find a finished or interrupted training with this fingerprint; otherwise make room for a new one.

    Args:
        wanted: Fingerprint of its training.
        reuse: Whether earlier trainings are looked for.
        ckpt: The checkpoint (ckpt=) that the training starts from.
        code: See `hash_code`; to name what has changed since the training in the folder.

    Raises:
        CophyError: A note of the folder is damaged, or another interrupted training would take the name of `ckpt`.
    """
    if reuse and (checkpoints := _find_finished(run, wanted)) is not None:
        log.info("already trained on the same data with the same settings: %s (reuse=false trains again)", checkpoints)
        is_own = checkpoints.resolve() == run.checkpoints.resolve()
        return Start(_adopt(checkpoints, run), run.checkpoints / "best.ckpt", keeps_curves=is_own)
    if reuse and (finished := _read(run.checkpoints, FINISHED)).get("fingerprint", wanted) != wanted:
        log.warning(
            "the results in %s come from %s: the model is trained again", run.directory, _difference(finished, code)
        )
    last, stopped = run.checkpoints / "last.ckpt", _read(run.checkpoints, BEGUN)
    if reuse and stopped.get("fingerprint") == wanted and last.is_file():
        log.info("continues where it stopped: %s (reuse=false trains again)", last)
        resumed = stopped["resumed"] + 1
        _write(run.checkpoints, BEGUN, {"fingerprint": wanted, "resumed": resumed})
        return Start(None, last, resumed + (ckpt is not None), keeps_curves=True)
    is_last = ckpt is not None and last.exists() and ckpt.samefile(last)
    older = last.with_name(STOPPED[last.name])
    if ckpt is not None and stopped and last.exists() and older.exists() and ckpt.samefile(older):
        raise CophyError(
            f"{last}, of another interrupted training, would take the name of {ckpt}: move one of them elsewhere"
        )
    best = None  # the best epoch of the training that `ckpt` is from
    if ckpt is not None:
        path = ckpt.with_name(STOPPED["best.ckpt"] if ckpt.name == STOPPED["last.ckpt"] else "best.ckpt")
        if path.is_file() and is_of_one_training(path, ckpt):
            best = read_file(path)
    _clear(run, keeps_last=bool(stopped) or is_last)
    if best is not None:  # the best epoch so far may remain the best
        run.checkpoints.mkdir(parents=True, exist_ok=True)
        write_atomically(run.checkpoints / "best.ckpt", best)
    _write(run.checkpoints, BEGUN, {"fingerprint": wanted, "resumed": 0})
    resumed_from = older if is_last else ckpt
    return Start(None, resumed_from, int(ckpt is not None), keeps_curves=ckpt is not None)


def record_finished(run: Run, wanted: str, facts: dict[str, Any]) -> None:
    """Store the fingerprint and facts of a finished training: what `trainer.fit` returns, resumed, and code (`hash_code`)."""
    _write(run.checkpoints, FINISHED, {"fingerprint": wanted, **facts})
    (run.checkpoints / BEGUN).unlink(missing_ok=True)


def _find_finished(run: Run, wanted: str) -> Path | None:
    """Return checkpoints of a finished training with this fingerprint: the run's own, or those of a run with another test."""
    directories = [run.directory]
    if run.root is not None:
        place = Path(run.scenario, "*", run.model, run.ablation, "*")
        for name in (f"seed{run.seed}", f"seed{run.seed}+*"):
            directories += sorted(run.root.glob(str(place / name)))
    for checkpoints in (directory / "checkpoints" for directory in directories):
        try:
            is_wanted = _read(checkpoints, FINISHED).get("fingerprint") == wanted
        except CophyError as error:
            if checkpoints == run.checkpoints:
                raise
            log.warning("a training is left out: %s", error)
            continue
        if is_wanted and _is_complete(checkpoints):
            return checkpoints
    return None


def _difference(finished: dict[str, Any], code: str) -> str:
    """Return in words what differs from a finished training."""
    if finished["code"] != code:
        return "other code (of cophy, or .py files next to your model, loss, callback, optimizer or schedule)"
    return "other data or settings, or another version of torch"


def _adopt(checkpoints: Path, run: Run) -> dict[str, Any]:
    """Copy finished checkpoints into the run and return the facts about their training."""
    if checkpoints.resolve() != run.checkpoints.resolve():
        _clear(run, keeps_last=(run.checkpoints / BEGUN).exists())
        run.checkpoints.mkdir(parents=True, exist_ok=True)
        for name in PAIR:
            shutil.copyfile(checkpoints / name, run.checkpoints / name)
        write_atomically(run.checkpoints / FINISHED, (checkpoints / FINISHED).read_bytes())
    facts = _read(run.checkpoints, FINISHED)
    return {key: facts[key] for key in ("training_seconds", "training_cpu_seconds", "resumed", "validation")}


def _clear(run: Run, *, keeps_last: bool) -> None:
    """Remove the checkpoints of an earlier training; those of an interrupted training are renamed."""
    last = run.checkpoints / "last.ckpt"
    if keeps_last and last.exists():
        log.warning(
            "%s belongs to a training with other settings or code, or a shorter one: it is renamed to %s",
            *(last, last.with_name(STOPPED[last.name])),
        )
        for name, kept in STOPPED.items():
            (run.checkpoints / kept).unlink(missing_ok=True)
            if (run.checkpoints / name).exists():
                os.replace(run.checkpoints / name, run.checkpoints / kept)
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
        content = read_json(path)
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise CophyError(f"{path} is damaged ({error}): delete it to train again") from error
    if wrong := [key for key, kind in NOTES[name].items() if not isinstance(content.get(key), kind)]:
        raise CophyError(f"{path} has no valid {', '.join(wrong)}: delete it to train again")
    return content
