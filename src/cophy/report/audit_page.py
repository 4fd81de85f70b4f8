"""The page of an audit: every line, and the distributions behind it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cophy.dataset.audit import Check
from cophy.dataset.audit.shares import paths_per_value
from cophy.dataset.spec import DatasetSpec
from cophy.report.figures import draw_stability_distribution


def write_page(checks: Sequence[Check], arrays: dict[str, np.ndarray], spec: DatasetSpec, directory: Path) -> Path:
    """Markdown and figures of one dataset, in `directory`; returns the page."""
    directory.mkdir(parents=True, exist_ok=True)
    failing = sum(not check.passed for check in checks)
    lines = [f"| {'ok' if check.passed else '**FAILS**'} | {check.name} | {check.found} |" for check in checks]
    figure = outcomes(arrays, spec)
    figure.savefig(directory / "outcomes.png", dpi=100)
    page = directory / "audit.md"
    page.write_text(
        f"# Audit of {spec.scenario.name}, {spec.id}\n\n{spec.num_experiments} experiments; "
        f"{failing or 'no'} of {len(checks)} lines fail.\n\n| | check | found |\n|---|---|---|\n"
        + "\n".join(lines)
        + "\n\n![Outcomes of CD for every value of the confounders](outcomes.png)\n"
    )
    return page


def outcomes(arrays: dict[str, np.ndarray], spec: DatasetSpec) -> Figure:
    """Outcomes of CD for every value of every confounder: towers that stand (paper Fig. 3), or lengths of paths."""
    if spec.scenario.name == "blocktower":
        standing = np.array([stratum.endswith("stands") for stratum in spec.scenario.strata()])
        return draw_stability_distribution({spec.num_objects: arrays}, {spec.num_objects: standing[arrays["stratum"]]})
    paths = {name: values for name, values in paths_per_value(arrays, spec).items() if len(values) > 1}
    figure = Figure(figsize=(3.6 * len(paths), 3.4), layout="constrained")
    for axis, (name, values) in zip(
        figure.subplots(1, len(paths), sharey=True, squeeze=False)[0], paths.items(), strict=True
    ):
        for value, lengths in values.items():
            axis.ecdf(lengths, label=f"{value:g}")
        axis.set_title(name, fontsize="medium")
        axis.set_xlabel("mean distance from the start in CD, m", fontsize="small")
        axis.legend(frameon=False)
        axis.grid(alpha=0.2)
    figure.axes[0].set_ylabel("share of objects")
    return figure
