"""Training, testing and using networks: stage 1 (de-renderers) and stage 2 (predictors of D).

Public names are imported on first use: `from cophy.training import PredictionModule`.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "DerenderingModule": "derenderer",
    "PredictionModule": "predictor",
    "Run": "run",
    "TrainedDerenderer": "trained",
    "TrainedPredictor": "trained",
    "make_trainer": "trainer",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
