"""Cells, do-operations and confounder values are level (paper Sec. 3: balanced and bias free)."""

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.stats import ks_2samp

from cophy.dataset.audit.checks import Arrays, Check, none_wrong, tolerance
from cophy.dataset.audit.first_frames import slots_in_order
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.state_features import mean_distance
from cophy.dataset.store.shardset import Sharded
from cophy.scenario import Scenario

# ours: Kolmogorov-Smirnov. What is heavy goes less far (0.55 for what is hit in collisions), but no value settles how far
MAX_APART = 0.65


def shares(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Frequencies of cells, do-operations and confounder values: as intended, up to chance and BALANCE_TOLERANCE."""
    scenario, count, grid = spec.scenario, len(arrays["twin"]), spec.scenario.confounders
    cells = len(scenario.blocks()[0])  # of the pairs that share a configuration
    yield _as_the_blocks(arrays, spec.scenario)
    kinds = dict(enumerate(scenario.do_operations))
    yield level("do-operations", arrays["do_operation"], kinds, draws=count // (2 * cells))
    present = arrays["object_index"] >= 0
    # each configuration that is drawn serves one experiment per cell
    for name in ("mass", "friction", "restitution"):
        values = {value: f"{value:g}" for value in getattr(grid, name)}
        yield level(name, arrays[name][present], values, draws=present.sum() // cells)
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        values = {value: f"{value:g}" for value in getattr(grid, name)}
        yield level(name, arrays["gravity"][:, axis], values, draws=count // cells)


def shapes(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Where a cell names the shapes of objects, they have these."""
    named = [spec.scenario.shapes_of_cell(cell) for cell in range(len(spec.scenario.cells()))]
    if named[0] is not None:
        slots = slots_in_order(arrays, spec.num_objects)
        found = np.take_along_axis(arrays["shape"], slots, axis=1)
        wrong = (found != np.array(named)[arrays["cell"]]).any(axis=1)
        yield none_wrong("shapes are those of the cell", np.flatnonzero(wrong).tolist())


def _as_the_blocks(arrays: Arrays, scenario: Scenario) -> Check:
    """Whether each cell has the share that it has in the scenario's blocks."""
    names, blocks = scenario.cells(), np.concatenate(scenario.blocks())
    expected = np.bincount(blocks, minlength=len(names)) / len(blocks)
    found = np.bincount(arrays["cell"], minlength=len(names)) / len(arrays["cell"])
    allowed = [tolerance(share, len(arrays["cell"])) for share in expected]
    text = "  ".join(f"{name} {share:.1%}" for name, share in zip(names, found, strict=True))
    return Check("share of cells", text, bool((np.abs(found - expected) <= allowed).all()))


def level(name: str, values: np.ndarray, labels: Mapping[int, str] | Mapping[float, str], *, draws: int) -> Check:
    """Whether each value has an equal share.

    Args:
        name: what is shared.
        values: found, any shape.
        labels: of the values that there are.
        draws: how many of the values were drawn independently.
    """
    share = {label: float(np.isclose(values, value).mean()) for value, label in labels.items()}
    equal = 1 / len(share)
    passed = all(abs(value - equal) <= tolerance(equal, draws) for value in share.values())
    return Check(f"share of {name}", "  ".join(f"{label} {value:.1%}" for label, value in share.items()), passed)


def trajectories(arrays: Arrays, spec: Sharded) -> Iterator[Check]:
    """How far apart the distributions of paths in CD are under two values of an object's own confounder."""
    for name, paths in paths_per_value(arrays, spec).items():
        samples = list(paths.values())
        if len(samples) > 1 and min(map(len, samples)) > 0:
            apart = max(ks_2samp(samples[0], other).statistic for other in samples[1:])
            limit = MAX_APART + 1 / np.sqrt(min(map(len, samples)))  # chance adds to it in tiny sets
            found = f"apart by {apart:.2f} ≤ {limit:.2f} (Kolmogorov-Smirnov)"
            yield Check(f"paths in CD per {name}", found, bool(apart <= limit))


def paths_per_value(arrays: Arrays, spec: Sharded) -> dict[str, dict[float, np.ndarray]]:
    """Confounder -> value -> how far objects with that value are from their start in CD, averaged over time, metres.

    Per object where the scenario has several cells, because these tell its objects apart (in the scenario's own order).
    Otherwise over all objects.
    """
    moved, presence = mean_distance(arrays)[:, 1], arrays["presence"][:, 1]
    places = [(f" of object {k}", arrays["object_index"] == k) for k in range(spec.num_objects)]
    return {
        name + place: {
            value: moved[presence & chosen & np.isclose(arrays[name], value)]
            for value in getattr(spec.scenario.confounders, name)
        }
        for place, chosen in (places if len(spec.scenario.cells()) > 1 else [("", presence)])
        for name in ("mass", "friction", "restitution")
    }
