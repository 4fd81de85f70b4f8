"""The table of the paper's claims, from cophy/claims.yaml: numbers and counts come from results.csv."""

import re
from collections.abc import Mapping

import yaml
from result_runs import COLUMNS, ROOT, Results, markdown, published

PERCENT = ("twin_difference_explained", "right_twin_chosen", "share", "sequence_stability_accuracy", "probe_accuracy")


def claims(results: Results) -> str:
    """Return the table; the verdict of a comparison is computed."""
    rows = []
    for claim in yaml.safe_load((ROOT / "docs" / "cophy" / "claims.yaml").read_text()):
        facts = {"paper": "–"} | (compared(results, **claim["compare"]) if "compare" in claim else {}) | claim
        ours = re.sub(r"\{([^}]*)\}", lambda found, facts=facts: value(results, found[1], facts), facts["ours"])
        rows.append([facts["claim"], facts["paper"], ours, facts["verdict"]])
    return markdown(["claim", "paper", "ours", "verdict"], rows)


def compared(
    results: Results, method: str, than: list[str], columns: list[str] | None = None, measure: str = "mse", **names: str
) -> dict[str, str]:
    """Count the columns and methods in which the 95 % interval of a method lies wholly on the better side of the other's.

    Args:
        results: The runs.
        method, than: What is compared with what.
        columns: `scenario split`; all of Tables 2 to 4 by default.
        measure: Column of results.csv.
        names: Further names of both runs.
    """
    places = (
        [column.split() for column in columns] if columns else [[scenario, split] for scenario, split, _ in COLUMNS]
    )
    pairs = [(place, other) for place in places for other in than]
    won = sum(is_better(results, measure, method, other, place, names) for place, other in pairs)
    facts = {
        "won": f"{won} of {len(pairs)}",
        "verdict": "✓" if won == len(pairs) else "~" if 2 * won >= len(pairs) else "✗",
    }
    printed = [(published(*place, method), published(*place, other)) for place, other in pairs]
    if measure == "mse" and all(None not in numbers for numbers in printed):
        facts["paper"] = f"{sum(one < two for one, two in printed)} of {len(pairs)}"
    return facts


def is_better(
    results: Results, measure: str, method: str, other: str, place: list[str], names: Mapping[str, str]
) -> bool:
    """Whether two intervals do not overlap, and the method's is on the better side."""
    one, two = (results.cell(measure, *place, name, **names) for name in (method, other))
    if one is None or two is None:
        raise SystemExit(f"claims.yaml: no {measure} of {method} or {other} on {' '.join(place)}")
    return one.low > two.high if measure in PERCENT else one.high < two.low


def value(results: Results, words: str, facts: Mapping[str, str]) -> str:
    """Return the number of `measure scenario split method key=value …`, or a fact of the comparison."""
    if words in facts:
        return facts[words]
    measure, scenario, split, method, *others = words.split()
    cell = results.cell(measure, scenario, split, method, **dict(other.split("=", 1) for other in others))
    if cell is None:
        raise SystemExit(f"claims.yaml: no run of {words}")
    return f"{cell.number(0, 100)} %" if measure in PERCENT else cell.number(1 if measure.startswith("pixel") else 3)
