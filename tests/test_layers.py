"""Imports point one way, and rooms are as small and as named as docs say."""

import ast
import re
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.conftest import ROOT

PACKAGE = ROOT / "src" / "cophy"
SCRIPTS = sorted((ROOT / "src").glob("*.py"))
MODULES = sorted(PACKAGE.rglob("*.py"))
ROOMS = sorted(path for path in MODULES if path.name == "__init__.py")
# each imports only those before it
LAYERS = ("scenario", "dataset", "models", "drawing", "training", "study", "report", "app", "commands")
FOR_ALL = {"errors", "atomic_files", "bootstrap", "types", "workers"}  # modules beside the layers
UNKNOWN_TO = {
    "scenario": {"torch", "lightning", "omegaconf", "hydra", "h5py"},
    "models": {"lightning", "omegaconf", "hydra", "h5py"},
}
MAX_LINES, MAX_FILES = 250, 9


def name_of(path: Path) -> str:
    """The module's dotted name."""
    return ".".join(path.relative_to(ROOT / "src").with_suffix("").parts).removesuffix(".__init__")


def imported(path: Path) -> set[str]:
    """Modules that a file imports, those inside functions too; of this package, the files."""
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
IMPORTS = {name_of(path): imported(path) for path in (*MODULES, *SCRIPTS)}


def layer_of(module: str) -> str:
    """scenario of cophy.scenario.balls."""
    return (*module.split("."), "")[1]


def test_the_layers_are_all_there_is() -> None:
    assert {layer_of(module) for module in KNOWN} == {*LAYERS, *FOR_ALL, ""}


@pytest.mark.parametrize("module", sorted(KNOWN))
def test_a_module_imports_only_earlier_layers(module: str) -> None:
    used, layer = {layer_of(name) for name in IMPORTS[module] & KNOWN}, layer_of(module)
    allowed = set(LAYERS[: LAYERS.index(layer) + 1]) if layer in LAYERS else {"app"} if module == "cophy" else set()
    assert used <= allowed | FOR_ALL | {""}


def test_no_module_imports_a_script() -> None:
    scripts = {path.stem for path in SCRIPTS}
    assert not [module for module, names in IMPORTS.items() if {name.split(".")[0] for name in names} & scripts]


@pytest.mark.parametrize("layer", UNKNOWN_TO)
def test_a_layer_knows_nothing_of(layer: str) -> None:
    for module in KNOWN:
        if layer_of(module) == layer:
            assert not {name.split(".")[0] for name in IMPORTS[module]} & UNKNOWN_TO[layer], module


def test_imports_have_no_cycle() -> None:
    """A package's `__init__` runs before its modules; what it imports of them is no cycle."""
    graph = {module: {n for n in names & KNOWN if not module.startswith(f"{n}.")} for module, names in IMPORTS.items()}
    list(TopologicalSorter(graph).static_order())


@pytest.mark.parametrize(
    "path", [path for path in MODULES if layer_of(name_of(path)) not in ("", "commands")], ids=name_of
)
def test_modules_of_the_package_are_imported_at_the_top(path: Path) -> None:
    """But by commands, whose --help shall not wait for torch, and by `cophy` itself."""
    inside = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)]
    for function in inside:
        local = [node for node in ast.walk(function) if isinstance(node, ast.ImportFrom)]
        assert not [node.module for node in local if str(node.module).startswith("cophy")], function.name


def test_no_two_files_share_a_name() -> None:
    counts = Counter(path.name for path in MODULES if path.name != "__init__.py")
    assert not [name for name, count in counts.items() if count > 1]


@pytest.mark.parametrize("path", [*MODULES, *SCRIPTS], ids=name_of)
def test_files_are_short(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= MAX_LINES


@pytest.mark.parametrize("path", ROOMS, ids=name_of)
def test_a_room_says_what_it_holds(path: Path) -> None:
    said = ast.get_docstring(ast.parse(path.read_text())) or ""
    held = [file.stem for file in path.parent.glob("*.py") if file != path]
    assert len(held) <= MAX_FILES
    if path.parent != PACKAGE:
        rooms = [room.parent.name for room in path.parent.glob("*/__init__.py")]
        assert not [name for name in (*held, *rooms) if not re.search(rf"\b{name}\b", said)]


def public_functions() -> dict[str, ast.FunctionDef]:
    """Functions and methods by their dotted names."""
    found = {}
    for path in MODULES:
        for node in ast.parse(path.read_text()).body:
            inside = node.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_") else [node]
            prefix = f"{name_of(path)}.{node.name}." if isinstance(node, ast.ClassDef) else f"{name_of(path)}."
            found |= {prefix + each.name: each for each in inside if isinstance(each, ast.FunctionDef)}
    return {name: function for name, function in found.items() if not function.name.startswith("_")}


def arguments_of(function: ast.FunctionDef) -> list[str]:
    """Names, without self and cls."""
    everything = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return [each.arg for each in everything if each.arg not in ("self", "cls")]


def explains(function: ast.FunctionDef) -> bool:
    """Whether every argument has its line under `Args:`."""
    lines = (ast.get_docstring(function) or "").partition("Args:")[2]
    return all(re.search(rf"^\s+[\w, *]*\b{name}\b[\w, *]*:", lines, re.MULTILINE) for name in arguments_of(function))


def test_functions_of_more_than_two_arguments_explain_them() -> None:
    """Or a base class does, of this package or of a library."""
    many = {name: each for name, each in public_functions().items() if len(arguments_of(each)) > 2}
    explained = {
        function.name for name, function in many.items() if name.split(".")[-2][0].isupper() and explains(function)
    }
    silent = []
    for name, function in many.items():
        of_class = name.split(".")[-2][0].isupper()
        inherited = of_class and (function.name in explained or ast.get_docstring(function) is None)
        if not inherited and not explains(function):
            silent.append(name)
    assert not silent
