"""Train once what several runs share: 3to3 and 3to4, for example, differ only in what they are tested on.

A finished training leaves its fingerprint, a hash of all that its weights depend on, beside its checkpoints.
"""

import hashlib
import inspect
import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn

import cophy
from cophy.training.runs.identity import Run
from cophy.training.trained.checkpoints import Origin

FINISHED = "finished.json"
CHECKPOINTS = ("best.ckpt", "last.ckpt")
# keys of `trainer` that no weight depends on
WITHOUT_EFFECT = {"enable_progress_bar", "enable_model_summary", "log_every_n_steps", "limit_test_batches", "profiler"}
# rooms of the package that no weight depends on: they only show what others computed. All others count, also those of
# which only a part does: a training too many costs minutes, a stale checkpoint a wrong table
SHOWING = ("drawing", "report")


class Trained(NamedTuple):
    """A finished training: how many seconds it took, and the validation metrics of its best epoch."""

    seconds: float
    validation: dict[str, float]


def fingerprint(network: nn.Module, origin: Origin, *, trainer: dict[str, Any], seed: int, threads: int) -> str:
    """Hash of all that the weights depend on: training data, model, training, trainer, seed, code, version of torch.

    The code is that of this package and of all modules beside the model's own. Which device was used is not part of it.

    Args:
        network: The network to train.
        origin: Says what it is and what it is trained on.
        trainer: Arguments of Lightning's Trainer.
        seed: Of the training.
        threads: Of torch.
    """
    depends_on = {
        "data": origin.trained_on,
        "model": origin.model,
        "training": origin.training,
        "trainer": {key: value for key, value in trainer.items() if key not in WITHOUT_EFFECT},
        "seed": seed,
        "threads": threads,
        "code": _hash_of_sources(network),
        "torch": torch.__version__,
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
        if _read(checkpoints).get("fingerprint") == wanted and all((checkpoints / c).is_file() for c in CHECKPOINTS):
            return checkpoints
    return None


def adopt(found: Path, run: Run) -> Trained:
    """Copy finished checkpoints into the run."""
    if found.resolve() != run.checkpoints.resolve():
        forget_checkpoints(run)
        run.checkpoints.mkdir(parents=True, exist_ok=True)
        for name in (*CHECKPOINTS, FINISHED):
            shutil.copyfile(found / name, run.checkpoints / name)
    about = _read(run.checkpoints)
    return Trained(float(about["training_seconds"]), about["validation"])


def forget_checkpoints(run: Run) -> None:
    """Before training anew: what lies there is not what will be tested."""
    for name in (FINISHED, "best.ckpt"):
        (run.checkpoints / name).unlink(missing_ok=True)


def record(run: Run, wanted: str, trained: Trained) -> None:
    """After training: write down what the checkpoints in the run's directory are.

    Args:
        run: The run.
        wanted: Fingerprint of its training.
        trained: What is known of it.
    """
    content = {"fingerprint": wanted, "training_seconds": trained.seconds, "validation": trained.validation}
    (run.checkpoints / FINISHED).write_text(json.dumps(content) + "\n")


def _read(checkpoints: Path) -> dict[str, Any]:
    try:
        content = json.loads((checkpoints / FINISHED).read_bytes())
    except (OSError, ValueError):
        return {}
    return (
        content
        if isinstance(content, dict) and {"fingerprint", "training_seconds", "validation"} <= content.keys()
        else {}
    )


def _hash_of_sources(network: nn.Module) -> str:
    package, own = Path(cophy.__file__).parent, inspect.getsourcefile(type(network))
    sources = {path for path in package.rglob("*.py") if path.relative_to(package).parts[0] not in SHOWING}
    sources |= set(Path(own).parent.glob("*.py")) if own else set()
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(sources))).hexdigest()
