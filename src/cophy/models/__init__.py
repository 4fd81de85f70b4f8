"""Networks: from what a model may see (`cophy.types.Inputs`) to a prediction of D. No Lightning, configuration or files.

Public names are imported on first use: `from cophy.models import CoPhyNet`.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "Alongside": "alongside",
    "CoPhyNet": "cophynet",
    "CopyB": "baselines",
    "CopyC": "baselines",
    "Derenderer": "derenderer",
    "DisplacedCopyB": "baselines",
    "FittedSpheres": "spheres",
    "GNS": "gns",
    "Hypotheses": "hypotheses",
    "InteractionNetwork": "baselines",
    "Replay": "baselines",
    "Transformer": "transformer",
    "Trees": "trees",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
