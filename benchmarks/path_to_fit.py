"""The way from the command line to Trainer.fit: functions, lines and files of cophy, and compositions of configurations.

Runs `train.py scenario=collision size=tiny` under a profile hook until Lightning's Trainer.fit is called. Functions of
scenario/, dataset/ and models/ are left out: they are called on the way, but are not the way.

    python benchmarks/path_to_fit.py data_dir=data
"""

import inspect
import os
import runpy
import sys
import tempfile
from collections import Counter
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
    """Return the lines of a function with its body, from the first to the last."""
    last = max((line for *_, line in code.co_lines() if line), default=code.co_firstlineno)
    inner = [num_lines(each) + each.co_firstlineno - 1 for each in code.co_consts if isinstance(each, CodeType)]
    return max([last, *inner]) - code.co_firstlineno + 1


if __name__ == "__main__":
    main()
