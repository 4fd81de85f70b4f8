"""Datasets that others released, read where they lie: one module per layout, one index over all."""

from cophy.dataset.external.clips import Clips
from cophy.dataset.external.index import ExternalStates
from cophy.dataset.external.layout import Layout, layout_named

__all__ = ["Clips", "ExternalStates", "Layout", "layout_named"]
