"""The table of the paper's claims, from cophy/claims.yaml: numbers and counts come from results.csv."""

import re
from collections.abc import Mapping
from math import copysign, hypot

import yaml
from result_runs import COLUMNS, ROOT, Results, markdown, published

PERCENT = ("twin_difference_explained", "right_twin_chosen", "share", "sequence_stability_accuracy", "probe_accuracy")
SIDES = {1: "for", -1: "against", 0: "open"}
VERDICTS = REPRODUCED, NOT_REPRODUCED, CANNOT_BE_TOLD = "reproduced", "not reproduced", "cannot be told"


def claims(results: Results) -> str:
    """Return the table; the verdict of a comparison is computed, unless the claim has one."""
    rows = []
    for claim in yaml.safe_load((ROOT / "docs" / "cophy" / "claims.yaml").read_text()):
        facts = {"paper": "–"} | (compared(results, **claim["compare"]) if "compare" in claim else {}) | claim
        ours = re.sub(r"\{([^}]*)\}", lambda found, facts=facts: value(results, found[1], facts), facts["ours"])
        rows.append([facts["claim"], facts["paper"], ours, facts["verdict"]])
    return markdown(["claim", "paper", "ours", "verdict"], rows)


def compared(
    results: Results, method: str, than: list[str], columns: list[str] | None = None, measure: str = "mse", **names: str
) -> dict[str, str]:
    """Count the columns and methods in which a method is better or worse than another.

    Args:
        results: The runs.
        method, than: What is compared with what; names of a run may follow an entry of `than`: `cophynet positions=derendered`.
        columns: `scenario split`, or a scenario for all of its columns; all of Tables 2 to 4 by default.
        measure: Column of the table of runs.
        names: Further names of both runs.
    """
    places = [
        place
        for column in columns or dict.fromkeys(scenario for scenario, _, _ in COLUMNS)
        for place in [[scenario, split] for scenario, split, _ in COLUMNS if scenario == column] or [column.split()]
    ]
    pairs = [(place, other) for place in places for other in than]
    sides = [side(results, measure, method, other, place, names) for place, other in pairs]
    facts = {"counts": counted(sides), "verdict": verdict(sides)}
    printed = [(published(*place, method), published(*place, other.split()[0])) for place, other in pairs]
    if measure == "mse" and all(None not in numbers for numbers in printed):
        facts["paper"] = counted([1 if one < two else -1 for one, two in printed])
    return facts


def side(results: Results, measure: str, method: str, other: str, place: list[str], names: Mapping[str, str]) -> int:
    """Return 1 if a method is better than another by more than both uncertainties, added in quadrature, -1 if worse, else 0.

    An uncertainty is the distance from the mean to the farthest end of the seeds' intervals. The comparison is unpaired.
    """
    name, *changes = other.split()
    one = results.cell(measure, *place, method, **names)
    two = results.cell(measure, *place, name, **names | dict(change.split("=", 1) for change in changes))
    if one is None or two is None:
        raise SystemExit(f"claims.yaml: no {measure} of {method} or {other} on {' '.join(place)}")
    lead = (one.value - two.value) * (1 if measure in PERCENT else -1)
    uncertainties = (max(cell.value - cell.lowest, cell.highest - cell.value) for cell in (one, two))
    return 0 if abs(lead) <= hypot(*uncertainties) else int(copysign(1, lead))


def counted(sides: list[int]) -> str:
    """Return how many comparisons are for and against a claim, and how many are open."""
    return ", ".join(f"{sides.count(side)} {name}" for side, name in SIDES.items() if side in sides)


def verdict(sides: list[int]) -> str:
    """Return whether all comparisons are for a claim, or some are against it."""
    return NOT_REPRODUCED if -1 in sides else CANNOT_BE_TOLD if 0 in sides else REPRODUCED


def value(results: Results, words: str, facts: Mapping[str, str]) -> str:
    """Return the number of `measure scenario split method key=value …`, or a fact of the comparison."""
    if words in facts:
        return facts[words]
    measure, scenario, split, method, *others = words.split()
    cell = results.cell(measure, scenario, split, method, **dict(other.split("=", 1) for other in others))
    if cell is None:
        raise SystemExit(f"claims.yaml: no run of {words}")
    return f"{cell.marked(0, 100)} %" if measure in PERCENT else cell.marked(1 if measure.startswith("pixel") else 3)
