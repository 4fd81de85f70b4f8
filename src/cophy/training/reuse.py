"""Train once what several rows share: 3to3 and 3to4, for example, differ only in what they are tested on.

A finished training leaves its fingerprint, a hash of all that its weights depend on, beside its checkpoints.
"""

import hashlib
import inspect
import json
import shutil
from pathlib import Path
from typing import Any

import torch
from torch import nn

import cophy
from cophy.dataset.datamodule import CounterfactualDataModule
from cophy.dataset.frames import FrameDataModule
from cophy.training.row import Row

FINISHED = "finished.json"
CHECKPOINTS = ("best.ckpt", "last.ckpt")
# keys of `trainer` that no weight depends on
WITHOUT_EFFECT = {"enable_progress_bar", "enable_model_summary", "log_every_n_steps", "limit_test_batches", "profiler"}


def fingerprint(data: CounterfactualDataModule | FrameDataModule, network: nn.Module, resolved: dict[str, Any]) -> str:
    """Hash of training data, model, training, trainer, seed, the code and the version of torch.

    The code is that of this package and of all modules beside the model's own. Which device was used is not part of it.
    """
    depends_on = {
        "data": data.training_depends_on,
        "model": resolved["model"],
        "training": resolved["training"],
        "trainer": {key: value for key, value in resolved["trainer"].items() if key not in WITHOUT_EFFECT},
        "seed": resolved["seed"],
        "threads": resolved["threads"],
        "code": _hash_of_sources(network),
        "torch": torch.__version__,
    }
    return hashlib.sha256(json.dumps(depends_on, sort_keys=True).encode()).hexdigest()


def find(row: Row, wanted: str) -> Path | None:
    """Checkpoints of a finished training with this fingerprint: of the row itself, or of its neighbours in other splits."""
    places = [row.directory]
    if row.root is not None:
        scenario, _, model, ablation, _, seed = row.place.parts
        places += sorted(row.root.glob(str(Path(scenario, "*", model, ablation, "*", seed))))
    for place in places:
        checkpoints = place / "checkpoints"
        if _read(checkpoints).get("fingerprint") == wanted and all((checkpoints / c).is_file() for c in CHECKPOINTS):
            return checkpoints
    return None


def adopt(found: Path, row: Row) -> float:
    """Copy finished checkpoints into the row; returns the seconds that their training took."""
    own = row.directory / "checkpoints"
    if found.resolve() != own.resolve():
        forget(row)
        own.mkdir(parents=True, exist_ok=True)
        for name in (*CHECKPOINTS, FINISHED):
            shutil.copyfile(found / name, own / name)
    return float(_read(own)["training_seconds"])


def forget(row: Row) -> None:
    """Before training anew: what lies there is not what will be tested."""
    for name in (FINISHED, "best.ckpt"):
        (row.directory / "checkpoints" / name).unlink(missing_ok=True)


def record(row: Row, of: str, *, training_seconds: float) -> None:
    """After training: what the checkpoints in the row's directory are."""
    content = {"fingerprint": of, "training_seconds": round(training_seconds, 1)}
    (row.directory / "checkpoints" / FINISHED).write_text(json.dumps(content) + "\n")


def _read(checkpoints: Path) -> dict[str, Any]:
    try:
        content = json.loads((checkpoints / FINISHED).read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) and {"fingerprint", "training_seconds"} <= content.keys() else {}


def _hash_of_sources(network: nn.Module) -> str:
    package, own = Path(cophy.__file__).parent, inspect.getsourcefile(type(network))
    sources = {path for path in package.rglob("*.py") if path.parent != package / "report"}
    sources |= set(Path(own).parent.glob("*.py")) if own else set()
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(sources))).hexdigest()
