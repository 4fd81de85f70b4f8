"""Counterfactual learning of physical dynamics (CoPhy, ICLR 2020).

    data = cophy.load("balls", size="small", split="train")  # a torch Dataset
    predictor = cophy.load_predictor("outputs/.../checkpoints/best.ckpt")  # D from AB and C

Rooms, each importing only those before it:

scenario: scenes, confounders, do-operations, simulation with PyBullet, and the search for experiments.
dataset: shards on disk, generation in parallel, released datasets, audits, and what models are fed.
models: what a model may see in, what it says about D out: CoPhyNet, its ablations, the baselines.
drawing: pictures for people.
training: Lightning modules, losses, metrics, runs and what comes out of them.
report: outputs/ -> the paper's tables, ours beside the paper's numbers.
app: the edge to Hydra; commands, tests and benchmarks import it, nothing else does.
commands: `python src/train.py`, or `cophy-train`, and the others.

Files that all rooms may import:

types: what passes between data, models and losses: `Inputs`, `Targets`, `Batch`, `Prediction`.
errors: the error whose message is meant for the person at the terminal.
atomic_files: files that are there whole or not at all.
bootstrap: means over experiments, and their intervals.
workers: processes that end with what started them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cophy.loading import load as load
    from cophy.loading import load_predictor as load_predictor

__version__ = "0.1.0"
__all__ = ["load", "load_predictor"]
_MODULES = {"load": "cophy.loading", "load_predictor": "cophy.loading"}


def __getattr__(name: str) -> Any:
    """The public functions, imported when asked for: they need every room, and every room imports this file."""
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'cophy' has no attribute '{name}'")
