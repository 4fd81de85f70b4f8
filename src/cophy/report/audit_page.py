"""The page of an audit: every line, and what is behind it in pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cophy.dataset.audit import Check, ClassifierCheck
from cophy.dataset.audit.balance import paths_per_value
from cophy.dataset.spec import DatasetSpec
from cophy.report.colors import BLUE, GREY, RED
from cophy.report.stability_distribution import draw_stability_distribution


def write_page(checks: Sequence[Check], arrays: dict[str, np.ndarray], spec: DatasetSpec, directory: Path) -> Path:
    """Write audit.md and its figures.

    Args:
        checks: The lines of the audit.
        arrays: The dataset.
        spec: Its description.
        directory: Where they go.

    Returns:
        The page.
    """
    directory.mkdir(parents=True, exist_ok=True)
    failing = sum(not check.passed for check in checks)
    lines = [f"| {'ok' if check.passed else '**FAILS**'} | {check.name} | {check.found} |" for check in checks]
    pictures = {}
    if (outcomes := draw_outcomes(arrays, spec)) is not None:
        pictures["Outcomes of CD for every value of the confounders"] = ("outcomes.png", outcomes)
    if asked := [check for check in checks if isinstance(check, ClassifierCheck)]:
        pictures["What can be known of CD without the motion of AB"] = ("bias.png", draw_classifiers(asked))
    for name, figure in pictures.values():
        figure.savefig(directory / name, dpi=100)
    page = directory / "audit.md"
    page.write_text(
        f"# Audit of {spec.scenario.name}, {spec.id}\n\n{spec.num_experiments} experiments; "
        f"{failing or 'no'} of {len(checks)} lines fail.\n\n| | check | found |\n|---|---|---|\n"
        + "\n".join(lines)
        + "".join(f"\n\n![{title}]({name})" for title, (name, _) in pictures.items())
        + "\n"
    )
    return page


def draw_classifiers(checks: Sequence[ClassifierCheck]) -> Figure:
    """Bars: each classifier's share of right guesses, with its interval, over the share by chance (grey).

    A classifier that is no better than chance has learned nothing.
    """
    figure = Figure(figsize=(9, 0.9 + 0.38 * len(checks)), layout="constrained")
    axis = figure.subplots()
    at = -np.arange(len(checks), dtype=float)
    accuracy, chance, low, high = (
        100 * np.array([getattr(check, name) for check in checks]) for name in ("accuracy", "chance", "low", "high")
    )
    axis.barh(at, chance, height=0.74, color=GREY, label="by chance")
    colors = [BLUE if check.passed else RED for check in checks]
    axis.barh(at, accuracy, height=0.4, color=colors, label="classifier, 95 % interval")
    axis.errorbar(accuracy, at, xerr=(accuracy - low, high - accuracy), fmt="none", ecolor="black", capsize=3, lw=1)
    axis.axvline(50, color="black", lw=0.8, ls="--")
    for place, share, end in zip(at, accuracy, np.maximum(high, chance), strict=True):
        axis.text(end + 1.5, place, f"{share:.1f} %", va="center", fontsize="small")
    axis.set_yticks(at, [check.name for check in checks], fontsize="small")
    axis.set_xlim(0, 108)
    axis.set_xticks(range(0, 101, 10))
    axis.set_xlabel("right guesses, %")
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper right", ncols=2, frameon=False, fontsize="small")
    return figure


def draw_outcomes(arrays: dict[str, np.ndarray], spec: DatasetSpec) -> Figure | None:
    """Outcomes of CD for every value of every confounder: towers that stand (paper Fig. 3), or lengths of paths.

    None where no confounder of objects has two values.
    """
    if spec.scenario.statics is not None:
        return draw_stability_distribution({spec.num_objects: arrays})
    paths = {name: values for name, values in paths_per_value(arrays, spec).items() if len(values) > 1}
    if not paths:
        return None
    figure = Figure(figsize=(3.6 * len(paths), 3.4), layout="constrained")
    for axis, (name, values) in zip(
        figure.subplots(1, len(paths), sharey=True, squeeze=False)[0], paths.items(), strict=True
    ):
        for value, lengths in values.items():
            axis.ecdf(lengths[np.isfinite(lengths)], label=f"{value:g}")
        axis.set_title(name, fontsize="medium")
        axis.set_xlabel("mean distance from the start in CD, m", fontsize="small")
        axis.legend(frameon=False)
        axis.grid(alpha=0.2)
    figure.axes[0].set_ylabel("share of objects")
    return figure
