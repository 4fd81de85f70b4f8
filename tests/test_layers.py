"""Imports point one way: each layer imports only those before it, and the core imports no optional subpackage."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.conftest import ROOT

PACKAGE = ROOT / "src" / "cophy"
MODULES = sorted(PACKAGE.rglob("*.py"))
BASE = {
    "errors",
    "locks",
    "atomic_files",
    "bootstrap",
    "scoring",
    "types",
    "untrusted_files",
    "workers",
}  # single files that everything may import
CORE = ("scenario", "dataset", "models", "drawing", "training", "report")  # each imports only those before it
OPTIONAL = ("oracles", "released", "audit", "study")  # they import the core, never the other way round
EDGE = {path.stem for path in PACKAGE.glob("*.py")} - BASE - {"__init__"} | {"commands"}  # may import everything
UNKNOWN_TO = {
    "scenario": {"torch", "lightning", "omegaconf", "hydra", "h5py"},
    "models": {"lightning", "omegaconf", "hydra", "h5py"},
}


def name_of(path: Path) -> str:
    """The module's dotted name."""
    return ".".join(path.relative_to(ROOT / "src").with_suffix("").parts).removesuffix(".__init__")


def imported(path: Path) -> set[str]:
    """Modules that a file imports, those inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in KNOWN else str(node.module) for name in inside}
    return found


KNOWN = {name_of(path) for path in MODULES}
IMPORTS = {name_of(path): imported(path) for path in MODULES}


def layer_of(module: str) -> str:
    """scenario of cophy.scenario.balls."""
    return (*module.split("."), "")[1]


def allowed_for(layer: str) -> set[str]:
    """The layers that a layer may import."""
    if layer in EDGE or layer == "":
        return {*EDGE, *CORE, *OPTIONAL, *BASE, ""}
    if layer in BASE:
        return {*BASE, ""}
    core = CORE if layer in OPTIONAL else CORE[: CORE.index(layer) + 1]
    return {layer, *core, *BASE, ""}


def test_the_layers_are_all_there_is() -> None:
    assert {layer_of(module) for module in KNOWN} == {*BASE, *CORE, *OPTIONAL, *EDGE, ""}


def test_a_module_imports_only_earlier_layers() -> None:
    used = {module: {layer_of(name) for name in IMPORTS[module] & KNOWN} for module in KNOWN}
    later = {module: layers - allowed_for(layer_of(module)) for module, layers in used.items()}
    assert {module: layers for module, layers in later.items() if layers} == {}


@pytest.mark.parametrize("layer", UNKNOWN_TO)
def test_a_layer_knows_nothing_of(layer: str) -> None:
    for module in KNOWN:
        if layer_of(module) == layer:
            assert not {name.split(".")[0] for name in IMPORTS[module]} & UNKNOWN_TO[layer], module


def test_imports_have_no_cycle() -> None:
    """A package's `__init__` runs before its modules; what it imports of them is no cycle."""
    graph = {module: {n for n in names & KNOWN if not module.startswith(f"{n}.")} for module, names in IMPORTS.items()}
    list(TopologicalSorter(graph).static_order())
