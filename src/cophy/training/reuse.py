"""Train once what several runs share, and go on with what was stopped.

3to3 and 3to4, for example, differ only in what they are tested on. A training leaves its fingerprint, a hash of all that its
weights depend on, beside its checkpoints: when it begins, and when it is finished.
"""

import hashlib
import inspect
import json
import logging
import os
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn

import cophy
from cophy.atomic_files import read_plain, sha256, write_atomically
from cophy.training.checkpoints import Origin, read_bytes
from cophy.training.run import Run

log = logging.getLogger(__name__)

FINISHED, BEGUN = "finished.json", "begun.json"
STOPPED = "last_of_stopped.ckpt"
KEYS = {FINISHED: {"fingerprint", "training_seconds", "validation", "resumed"}, BEGUN: {"fingerprint", "resumed"}}
CHECKPOINTS = ("best.ckpt", "last.ckpt")
# keys of `trainer` that no weight depends on
WITHOUT_EFFECT = {
    *("enable_progress_bar", "enable_model_summary", "log_every_n_steps", "limit_test_batches", "profiler"),
    *(
        "accelerator",
        "devices",
        "num_nodes",
        "strategy",
    ),  # they round otherwise; of several devices each averages over its own part of a batch
}
# rooms of the package that no weight depends on: they only show what others computed. All others count, also those of
# which only a part does: a training too many costs minutes, a stale checkpoint a wrong table
SHOWING = ("drawing", "report")


_PACKAGE = Path(cophy.__file__).parent
_CODE = {  # as it was when the command began: an edit while data are generated is of the next command
    path: path.read_bytes() for path in _PACKAGE.rglob("*.py") if path.relative_to(_PACKAGE).parts[0] not in SHOWING
}


class Trained(NamedTuple):
    """A finished training.

    seconds: how many it took. validation: the metrics of its best epoch. resumed: how often it was stopped and went on.
    """

    seconds: float
    validation: dict[str, float]
    resumed: int


def fingerprint(
    network: nn.Module, origin: Origin, settings: dict[str, Any], *, resumed_from: Path | None = None
) -> str:
    """Hash of all that the weights depend on: training data, model, training, trainer, seed, code, version of torch.

    The code is that of this package and of all modules beside the model's own. Which device was used is not part of it.

    Args:
        network: The network to train.
        origin: Says what it is and what it is trained on.
        settings: `trainer` (arguments of Lightning's Trainer), `seed` of the training, `threads` of torch.
        resumed_from: The checkpoint that it goes on from, of another training.
    """
    depends_on = {
        "data": origin.trained_on,
        "model": origin.model,
        "training": origin.training,
        **settings,
        "trainer": {key: value for key, value in settings["trainer"].items() if key not in WITHOUT_EFFECT},
        "code": _hash_of_sources(network),
        "torch": torch.__version__,
        "resumed_from": sha256(resumed_from) if resumed_from else None,
    }
    return hashlib.sha256(json.dumps(depends_on, sort_keys=True).encode()).hexdigest()


def find_checkpoints(run: Run, wanted: str) -> Path | None:
    """Checkpoints of a finished training with this fingerprint: of the run itself, or of its neighbours in other splits."""
    places = [run.directory]
    if run.root is not None:
        scenario, _, model, ablation, _, seed = run.place.parts
        places += sorted(run.root.glob(str(Path(scenario, "*", model, ablation, "*", seed))))
    for place in places:
        checkpoints = place / "checkpoints"
        if _read(checkpoints, FINISHED).get("fingerprint") == wanted and _whole(checkpoints):
            return checkpoints
    return None


def begin(run: Run, wanted: str, *, anew: bool, given: Path | None = None) -> int:
    """Note that a training begins in the run's directory, or goes on there: with this fingerprint, after it was stopped.

    Args:
        run: The run.
        wanted: Fingerprint of its training.
        anew: Whether it begins in any case.
        given: The checkpoint that it begins with; its best one counts on.

    Returns:
        How often it was stopped before; 0 where it begins, and then no checkpoint of another one can pass for its own.
    """
    known = _read(run.checkpoints, BEGUN)
    goes_on = not anew and known.get("fingerprint") == wanted and _whole(run.checkpoints)
    if not goes_on:
        best = read_bytes(given.with_name("best.ckpt")) if given and given.with_name("best.ckpt").is_file() else None
        _set_aside(run.checkpoints, known, given)
        forget_checkpoints(run)
        if best is not None:
            run.checkpoints.mkdir(parents=True, exist_ok=True)
            write_atomically(run.checkpoints / "best.ckpt", best)
    resumed = known["resumed"] + 1 if goes_on else 0
    _write(run.checkpoints, BEGUN, {"fingerprint": wanted, "resumed": resumed})
    return int(resumed)


def adopt(found: Path, run: Run) -> Trained:
    """Copy finished checkpoints into the run."""
    if found.resolve() != run.checkpoints.resolve():
        forget_checkpoints(run)
        run.checkpoints.mkdir(parents=True, exist_ok=True)
        for name in (*CHECKPOINTS, FINISHED):
            shutil.copyfile(found / name, run.checkpoints / name)
    about = _read(run.checkpoints, FINISHED)
    return Trained(float(about["training_seconds"]), about["validation"], int(about["resumed"]))


def forget_checkpoints(run: Run) -> None:
    """Before training anew: what lies there is not what will be tested."""
    for name in (FINISHED, BEGUN, *CHECKPOINTS):
        (run.checkpoints / name).unlink(missing_ok=True)


def record(run: Run, wanted: str, trained: Trained) -> None:
    """After training: write down what the checkpoints in the run's directory are.

    Args:
        run: The run.
        wanted: Fingerprint of its training.
        trained: What is known of it.
    """
    about = {"training_seconds": trained.seconds, "validation": trained.validation, "resumed": trained.resumed}
    _write(run.checkpoints, FINISHED, {"fingerprint": wanted, **about})
    (run.checkpoints / BEGUN).unlink(missing_ok=True)


def _set_aside(checkpoints: Path, known: dict[str, Any], given: Path | None) -> None:
    """Keep the last checkpoint of an unfinished training of other settings or code, and the one that is given."""
    last = checkpoints / "last.ckpt"
    is_given = given is not None and last.exists() and given.exists() and given.samefile(last)
    if last.exists() and (known or is_given):
        kept = checkpoints / STOPPED
        os.replace(last, kept)
        log.warning("%s is of a training with other settings or code, or a shorter one: it is kept as %s", last, kept)


def _whole(checkpoints: Path) -> bool:
    return all((checkpoints / name).is_file() for name in CHECKPOINTS)


def _write(checkpoints: Path, name: str, content: dict[str, Any]) -> None:
    checkpoints.mkdir(parents=True, exist_ok=True)
    write_atomically(checkpoints / name, (json.dumps(content) + "\n").encode())


def _read(checkpoints: Path, name: str) -> dict[str, Any]:
    try:
        content = json.loads(read_plain(checkpoints / name))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) and KEYS[name] <= content.keys() else {}


def _hash_of_sources(network: nn.Module) -> str:
    own = inspect.getsourcefile(type(network))
    beside = {path: path.read_bytes() for path in Path(own).parent.glob("*.py")} if own else {}
    sources = beside | _CODE
    return hashlib.sha256(b"".join(sources[path] for path in sorted(sources))).hexdigest()
