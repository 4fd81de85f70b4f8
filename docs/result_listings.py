"""Tables that list what other files have: the published weights, and the columns of results.csv."""

import csv
from pathlib import Path

from result_runs import ROOT, Results, markdown


def read_csv(path: Path) -> list[dict[str, str]]:
    """Return the lines of a CSV."""
    with path.open(newline="") as lines:
        return list(csv.DictReader(lines))


def checkpoints(results: Results) -> str:
    """The published weights; those whose row of results.csv is another training are marked."""
    rows = []
    for line in read_csv(ROOT / "checkpoints" / "index.csv"):
        if line["method"] == "derenderer":
            continue
        runs = results.of(line["scenario"], line["split"], line["method"], r"(\+learning_rate-.*)?", size="small")
        same = f"{next(run['mse'] for run in runs if run['seed'] == 0):.4f}" == line["test_mse"]
        rows.append(
            [f"`{line['file']}`", line["sha256"][:8], f"`{line['choice']}`", line["test_mse"] + ("" if same else " ᶜ")]
        )
    return markdown(["file", "SHA-256", "trained with", "test MSE, m²"], rows)


def derenderers() -> str:
    """The published weights of de-renderers."""
    rows = [
        [
            f"`{line['file']}`",
            line["sha256"][:8],
            f"`{line['choice']}`",
            f"{float(line['euclidean_error']):.2f}",
            f"{float(line['presence_accuracy']):.2%}",
        ]
        for line in read_csv(ROOT / "checkpoints" / "index.csv")
        if line["method"] == "derenderer"
    ]
    return markdown(["file", "SHA-256", "trained with", "test position error, m", "presence correct"], rows)


def column_meanings() -> str:
    """What the columns of results.csv mean."""
    meanings = read_csv(ROOT / "docs" / "results" / "columns.csv")
    has_interval = {line["column"].removesuffix("_low") for line in meanings if line["column"].endswith("_low")}
    rows = [
        [f"`{name}`{' *' if name in has_interval else ''}", line["meaning"], line["unit"] or "–"]
        for line in meanings
        if not (name := line["column"]).endswith(("_low", "_high"))
    ]
    return markdown(["column", "meaning", "unit"], rows)
