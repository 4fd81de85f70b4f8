"""Leaderboard entries from elsewhere: leaderboard/*.yaml, one file per method, with a closed set of keys.

python docs/result_entries.py FILE ... checks files.
"""

import re
import sys
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import yaml
from result_runs import ROOT, SCENARIOS, columns, markdown

from cophy.report.paper_tables import TRUE_POSITIONS
from cophy.schemas import ESTIMATED

ENTRIES = ROOT / "leaderboard"
OUR_EXAMPLES = {f"docs/examples/{path.name}" for path in (ROOT / "docs" / "examples").glob("*.py")}
MAX_BYTES, MAX_TEXT = 1 << 16, 200  # of a file, and of a text in it
SEES = ("AB", "C", "object_type", "pose", "confounders", "simulator", "external_data")
SPLITS = {name: tuple(columns(name)) for name in SCENARIOS}
HASH, ADDRESS = re.compile(r"[0-9a-f]{64}"), re.compile(r"https?://[\w./~%#?=&+-]+")
NAME = re.compile(r"[\w .,()+-]+")  # no character of Markdown or HTML
LARGEST = 1e6  # m²; the largest MSE of a finite prediction that makes sense is far below


class EntryError(Exception):
    """A line that names the file, the key and the remedy."""


@dataclass(frozen=True)
class Score:
    """Scores of one file of predictions, as score.py prints them; [mean, low, high]."""

    scenario: str
    split: str
    size: str
    data_seed: int
    seed: int
    positions: str
    sha256: str
    num_test: int
    mse: list[float]
    twin_difference_explained: list[float]
    right_twin_chosen: list[float]


@dataclass(frozen=True)
class Entry:
    """A method."""

    name: str
    code: str
    sees: list[str]
    parameters: int
    scores: list[Score]
    paper: str | None = None


def read_entries(folder: Path = ENTRIES) -> list[Entry]:
    """Return all entries, by file name.

    Raises:
        EntryError: A file is no entry, or two have one name.
    """
    entries: dict[str, Entry] = {}
    for path in sorted(folder.glob("*.yaml")):
        entry = read_entry(path)
        if entry.name in entries:
            raise EntryError(f"{path.name}: name={entry.name} is that of another file")
        entries[entry.name] = entry
    return list(entries.values())


def read_entry(path: Path) -> Entry:
    """Return the entry in a file."""
    try:
        if path.is_symlink() or not path.is_file() or path.stat().st_size > MAX_BYTES:
            raise EntryError(f"it is no regular file of at most {MAX_BYTES} bytes")
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        _check_keys(content, Entry, "")
        if not isinstance(content["scores"], list) or not content["scores"]:
            raise EntryError("scores: no list of what score.py prints")
        scores = []
        for index, each in enumerate(content["scores"]):
            _check_keys(each, Score, f"scores[{index}].")
            scores.append(Score(**each))
        entry = Entry(**{**content, "scores": scores})
        if wrong := next(_problems(entry), None):
            raise EntryError(wrong)
    except (EntryError, OSError, TypeError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise EntryError(f"{path.name}: {' '.join(str(error).split())}") from error
    return entry


def _check_keys(content: Any, schema: type, prefix: str) -> None:
    if not isinstance(content, dict):
        raise EntryError(f"{prefix.rstrip('.') or 'the file'} has no keys")
    known = {field.name: field.default is MISSING for field in fields(schema)}
    if unknown := [str(key) for key in content if key not in known]:
        raise EntryError(f"{prefix}{unknown[0]}: there is no such key; there are {', '.join(known)}")
    if missing := [key for key, required in known.items() if required and key not in content]:
        raise EntryError(f"{prefix}{missing[0]} is missing")


def _problems(entry: Entry) -> Iterator[str]:
    """Yield what is wrong with the values of an entry."""
    if not isinstance(entry.name, str) or not NAME.fullmatch(entry.name) or len(entry.name) > MAX_TEXT:
        yield "name: letters, digits, blanks and . , ( ) + - only"
    if not _is_address(entry.code) and entry.code not in OUR_EXAMPLES:
        yield "code: no address that begins with https://"
    if entry.paper is not None and not _is_address(entry.paper):
        yield "paper: no address that begins with https://"
    if not isinstance(entry.sees, list) or not entry.sees or any(each not in SEES for each in entry.sees):
        yield f"sees: a list of some of {', '.join(SEES)}"
    if not _is_count(entry.parameters):
        yield "parameters: no number of trained parameters"
    seen = set()
    for index, score in enumerate(entry.scores):
        yield from (f"scores[{index}].{problem}" for problem in _problems_of_score(score))
        key = (score.scenario, score.split, score.size, score.data_seed, score.seed, score.positions)
        if key in seen:
            yield f"scores[{index}]: another one has the same split, size and seeds"
        seen.add(key)


def _problems_of_score(score: Score) -> Iterator[str]:
    if score.scenario not in SPLITS:
        yield f"scenario: none of {', '.join(SPLITS)}"
    elif score.split not in SPLITS[score.scenario]:
        yield f"split: none of {', '.join(SPLITS[score.scenario])}"
    if score.size not in ("small", "paper"):
        yield "size: neither small nor paper"
    if score.positions not in ESTIMATED:
        yield f"positions: none of {', '.join(ESTIMATED)}"
    for key in ("data_seed", "seed", "num_test"):
        if not _is_count(getattr(score, key)):
            yield f"{key}: no number from 0"
    if not isinstance(score.sha256, str) or not HASH.fullmatch(score.sha256):
        yield "sha256: not the 64 hexadecimal digits that score.py prints"
    for key, lowest, highest in (
        ("mse", 0.0, LARGEST),
        ("twin_difference_explained", -LARGEST, 1.0),
        ("right_twin_chosen", 0.0, 1.0),
    ):
        value = getattr(score, key)
        if (
            not isinstance(value, list)
            or len(value) != 3
            or not all(isinstance(each, int | float) and lowest <= each <= highest for each in value)
            or not value[1] <= value[0] <= value[2]
        ):
            yield f"{key}: not [mean, low, high] from {lowest:g} to {highest:g}"


def _is_address(value: Any) -> bool:
    return isinstance(value, str) and ADDRESS.fullmatch(value) is not None


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 40


def entries_table() -> str:
    """A line per entry and column: mean MSE over seeds, ± standard deviation or half the interval of a single run."""
    rows = []
    for entry in read_entries():
        groups: dict[tuple[Any, ...], list[Score]] = {}
        for score in entry.scores:
            key = (score.scenario, score.split, score.size, score.positions, score.data_seed)
            groups.setdefault(key, []).append(score)
        for (scenario, split, size, positions, data_seed), scores in groups.items():
            rows.append(
                [
                    f"{entry.name} (`{entry.code}`)" if entry.code in OUR_EXAMPLES else f"[{entry.name}]({entry.code})",
                    ", ".join(entry.sees),
                    f"{entry.parameters:,}",
                    f"{scenario} {split}, {size}"
                    + (f", data seed {data_seed}" if data_seed else "")
                    + ("" if positions == TRUE_POSITIONS else ", estimated positions"),
                    f"{len(scores)}",
                    _cell([score.mse for score in scores], 3),
                    _cell([[100 * each for each in score.twin_difference_explained] for score in scores], 1),
                    _cell([[100 * each for each in score.right_twin_chosen] for score in scores], 1),
                ]
            )
    header = [
        "method",
        "sees",
        "parameters",
        "data",
        "runs",
        "MSE, m²",
        "twins' difference explained, %",
        "right twin, %",
    ]
    return markdown(header, rows)


def _cell(values: list[list[float]], digits: int) -> str:
    means = [value[0] for value in values]
    spread = stdev(means) if len(means) > 1 else (values[0][2] - values[0][1]) / 2
    return f"{fmean(means):.{digits}f} ±{spread:.{digits}f}"


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]):
        try:
            sys.stdout.write(f"{path}: valid; its scores: {len(read_entry(path).scores)}\n")
        except EntryError as error:
            sys.exit(str(error))
