"""Generated and released datasets: specification, shards on disk, splits, images, and batches for models.

Public names are imported on first use; importing the package loads none of its modules.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "CounterfactualDataModule": "datamodules",
    "DatasetSpec": "spec",
    "ExperimentDataset": "datamodules",
    "FrameDataModule": "frames",
    "Images": "images",
    "Size": "spec",
    "Source": "source",
    "Split": "splits",
    "States": "states",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
