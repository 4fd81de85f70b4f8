"""Imports point one way."""

import re
from pathlib import Path

import pytest

from tests.conftest import ROOT

LAYERS = ("scenario", "dataset", "models", "training", "report")
PACKAGE = ROOT / "src" / "cophy"


@pytest.mark.parametrize("path", [p for layer in LAYERS for p in (PACKAGE / layer).rglob("*.py")], ids=str)
def test_a_layer_imports_only_earlier_layers(path: Path) -> None:
    used = set(re.findall(r"^\s*(?:from|import) cophy\.(\w+)", path.read_text(), re.MULTILINE))
    layer = path.relative_to(PACKAGE).parts[0]
    assert not used & set(LAYERS[LAYERS.index(layer) + 1 :])


@pytest.mark.parametrize(
    ("layer", "forbidden"),
    [("scenario", "torch|lightning|omegaconf|hydra"), ("models", "lightning|omegaconf|hydra|h5py")],
)
def test_a_layer_knows_nothing_of(layer: str, forbidden: str) -> None:
    for path in (PACKAGE / layer).rglob("*.py"):
        assert not re.search(rf"^\s*(from|import) ({forbidden})\b", path.read_text(), re.MULTILINE), path
