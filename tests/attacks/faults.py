"""What can be wrong with a file: each fault changes one, in a way that hypothesis chooses; it returns a second one."""

import json
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

Draw = Callable[[st.SearchStrategy], Any]
STRANGE = (None, True, -1, 0, 10**400, 1e308, float("nan"), float("inf"), "", "../x", "a" * 5000, [], {}, [[]], "\x00")
TEXTS = ("", "null", "[]", "{}", "[" * 100_000, "a: &a [*a]", "<html>", "x" * 10**6, '{"shards": "x"}', "\x00\xff")


class Payload:
    """Makes a folder when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def cut(path: Path, draw: Draw) -> Path | None:
    os.truncate(path, draw(st.integers(0, max(path.stat().st_size - 1, 0))))


def flip(path: Path, draw: Draw) -> Path | None:
    content = bytearray(path.read_bytes())
    for _ in range(draw(st.sampled_from([1, 1, 10]))):
        if content:
            content[draw(st.integers(0, len(content) - 1))] ^= 1 << draw(st.integers(0, 7))
    path.write_bytes(content)


def lengthen(path: Path, draw: Draw) -> Path | None:
    with open(path, "ab") as file:
        file.write(draw(st.binary(min_size=1, max_size=2000)))


def huge(path: Path, draw: Draw) -> Path | None:
    """A terabyte of which nothing lies on the disk."""
    os.truncate(path, 2**40)


def swap(path: Path, draw: Draw) -> Path | None:
    """What lies beside it, or another file of this kind, is in its place, and it in that one's."""
    others = sorted(each for each in path.parents[1].rglob(f"*{path.suffix}") if each != path and each.is_file())
    if others:
        other = draw(st.sampled_from(others))
        content = path.read_bytes()
        shutil.copyfile(other, path)
        other.write_bytes(content)
        return other
    return None


def remove(path: Path, draw: Draw) -> Path | None:
    path.unlink()


def folder(path: Path, draw: Draw) -> Path | None:
    path.unlink()
    path.mkdir()


def link(path: Path, draw: Draw) -> Path | None:
    target = draw(st.sampled_from(["/dev/zero", "/dev/full", "nowhere", path.name, "/etc/passwd"]))
    path.unlink()
    path.symlink_to(target)


def pipe(path: Path, draw: Draw) -> Path | None:
    path.unlink()
    os.mkfifo(path)


def text(path: Path, draw: Draw) -> Path | None:
    path.write_text(draw(st.one_of(st.sampled_from(TEXTS), st.text(max_size=200))), errors="surrogatepass")


def pickled(path: Path, draw: Draw) -> Path | None:
    path.write_bytes(pickle.dumps(Payload(path.parent / "executed"), protocol=draw(st.integers(0, 5))))


def value(path: Path, draw: Draw) -> Path | None:
    """One value of a JSON file is another."""
    content = json.loads(path.read_bytes())
    places = list(_places(content))
    if not places:
        return
    holder, key = draw(st.sampled_from(places))
    if draw(st.booleans()):
        holder[key] = draw(st.sampled_from(STRANGE))
    else:
        del holder[key]
    path.write_text(json.dumps(content) if "1e400" not in str(content) else "{}")


def _places(content: Any) -> Any:
    if isinstance(content, dict | list):
        for key, inner in content.items() if isinstance(content, dict) else enumerate(content):
            yield content, key
            yield from _places(inner)


FAULTS: tuple[Callable[[Path, Draw], Path | None], ...] = (
    cut, flip, lengthen, huge, swap, remove, folder, link, pipe, text, pickled
)  # fmt: skip


def faults_of(path: Path) -> tuple[Callable[[Path, Draw], Path | None], ...]:
    """Those that such a file can have."""
    return (*FAULTS, value, value, value) if path.suffix == ".json" else FAULTS
