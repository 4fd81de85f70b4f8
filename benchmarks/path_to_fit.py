"""The way from the command line to Trainer.fit: functions, code lines and files of cophy, and compositions of configurations.

Runs `train.py scenario=collision size=tiny` under a profile hook until Lightning's Trainer.fit is called. Functions of
scenario/, dataset/ and models/ are left out: they are called on the way, but are not the way.

    python benchmarks/path_to_fit.py data_dir=data
"""

import ast
import inspect
import os
import runpy
import sys
import tempfile
from collections import Counter
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "cophy"
LEFT_OUT = ("scenario", "dataset", "models")


class FitReachedError(BaseException):
    """Ends the command where Trainer.fit begins."""


def main() -> None:
    """Print a line per file and the sums."""
    codes: set[CodeType] = set()
    compositions = 0

    def hook(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal compositions
        if event != "call":
            return
        code, name = frame.f_code, frame.f_code.co_filename
        if name.startswith(str(PACKAGE)) and code.co_flags & inspect.CO_OPTIMIZED:  # no bodies of modules and classes
            codes.add(code)
        elif code.co_name == "_load_configuration_impl" and name.endswith("config_loader_impl.py"):
            compositions += 1
        elif code.co_name == "fit" and name.endswith("trainer/trainer.py"):
            sys.setprofile(None)
            raise FitReachedError

    with tempfile.TemporaryDirectory() as directory:
        sys.argv = [
            "src/train.py",
            "scenario=collision",
            "size=tiny",
            "logger=[]",
            f"hydra.run.dir={directory}",
            *sys.argv[1:],
        ]
        sys.path.insert(0, str(ROOT / "src"))
        os.environ["HYDRA_FULL_ERROR"] = "1"
        sys.setprofile(hook)
        try:
            runpy.run_path(str(ROOT / "src" / "train.py"), run_name="__main__")
        except FitReachedError:
            pass
        finally:
            sys.setprofile(None)

    functions = outermost(code for code in codes if part_of(code) not in LEFT_OUT)
    lines: Counter[str] = Counter()
    for code in functions:
        lines[str(Path(code.co_filename).relative_to(PACKAGE))] += num_lines(code)
    for name, count in sorted(lines.items()):
        print(f"{count:5} {name}")
    print(f"{len(functions)} functions, {sum(lines.values())} lines, {len(lines)} files, {compositions} compositions")


def part_of(code: CodeType) -> str:
    """Return the subpackage of a function."""
    return Path(code.co_filename).relative_to(PACKAGE).parts[0]


def outermost(codes: Any) -> list[CodeType]:
    """Return the functions that are not inside another one of them: comprehensions and closures count once."""
    every = list(codes)
    inner = {constant for code in every for constant in code.co_consts if isinstance(constant, CodeType)}
    return [code for code in every if code not in inner]


def num_lines(code: CodeType) -> int:
    """Return the code lines of a function: without docstrings, imports, comments and blank lines."""
    first, last = code.co_firstlineno, last_line(code)
    lines = enumerate(Path(code.co_filename).read_text().splitlines(), 1)
    skipped = lines_without_code(code.co_filename)
    return sum(
        first <= number <= last and number not in skipped and line.strip()[:1] not in ("", "#")
        for number, line in lines
    )


def last_line(code: CodeType) -> int:
    """Return the last line of a function, with the functions inside it."""
    inner = [last_line(each) for each in code.co_consts if isinstance(each, CodeType)]
    return max([code.co_firstlineno, *(line for *_, line in code.co_lines() if line), *inner])


@cache
def lines_without_code(file: str) -> set[int]:
    """Return the lines of docstrings and imports of a file."""
    nodes: list[ast.AST] = []
    for node in ast.walk(ast.parse(Path(file).read_text())):
        is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if is_docstring or isinstance(node, ast.Import | ast.ImportFrom):
            nodes.append(node)
    return {line for node in nodes for line in range(node.lineno, node.end_lineno + 1)}  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
