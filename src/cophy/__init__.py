"""Counterfactual learning of physical dynamics (CoPhy, ICLR 2020).

    data = cophy.load("balls", size="small", split="train")  # a torch Dataset
    predictor = cophy.load_predictor("outputs/.../checkpoints/best.ckpt")  # D from AB and C
    scores = cophy.score(predictions, cophy.load_truth("balls"))  # NumPy arrays, see cophy.scoring

Subpackages, each importing only those before it: scenario (what is simulated), dataset (shards, splits, batches), models,
drawing (images and figures), training (training, testing, metrics) and report (tables and figures next to the paper's).
Optional ones: oracles, released (datasets of others), audit and study (human participants). At the edge: schemas, config, cli
and commands. The single file scoring computes all scores of predictions, from NumPy arrays.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cophy.errors import CophyError as CophyError
    from cophy.loading import load as load
    from cophy.loading import load_predictor as load_predictor
    from cophy.scoring import score as score
    from cophy.submission import load_truth as load_truth

__version__ = "0.4.0"  # 0.<FORMAT_VERSION of data>.<number of the release>
__all__ = ["CophyError", "load", "load_predictor", "load_truth", "score"]
_MODULES = {
    "CophyError": "cophy.errors",
    "load": "cophy.loading",
    "load_predictor": "cophy.loading",
    "load_truth": "cophy.submission",
    "score": "cophy.scoring",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use, because it needs every subpackage and each of them imports this file."""
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'cophy' has no attribute '{name}'")
