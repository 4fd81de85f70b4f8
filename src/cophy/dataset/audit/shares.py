"""Strata, do-operations and confounder values are level (paper Sec. 3: balanced and bias free)."""

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.stats import ks_2samp

from cophy.dataset.audit.check import Arrays, Check, none_wrong, tolerance
from cophy.dataset.audit.geometry import slots_in_order
from cophy.dataset.audit.outcomes import mean_distance
from cophy.dataset.external.spec import ExternalSpec
from cophy.dataset.spec import DatasetSpec
from cophy.scenario import Shape

FURTHEST = 0.5  # ours: Kolmogorov-Smirnov; a heavy object flies less far than a light one, but no value settles how far


def shares(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Frequencies of strata, do-operations and confounder values: equal, up to chance and BALANCE."""
    scenario, count, cells = spec.scenario, len(arrays["twin"]), spec.scenario.num_cells()
    strata, kinds, grid = scenario.strata(), scenario.do_operations, scenario.confounders
    yield level("strata", arrays["stratum"], dict(enumerate(strata)), draws=count)
    yield level("do-operations", arrays["do_operation"], dict(enumerate(kinds)), draws=count // (2 * cells))
    present = arrays["object_index"] >= 0
    # each configuration that is drawn serves one experiment per cell
    for name in ("mass", "friction", "restitution"):
        values = {value: f"{value:g}" for value in getattr(grid, name)}
        yield level(name, arrays[name][present], values, draws=present.sum() // cells)
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        values = {value: f"{value:g}" for value in getattr(grid, name)}
        yield level(name, arrays["gravity"][:, axis], values, draws=count // cells)


def shapes(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Collisions: the stratum names the shapes of the moving and the static object."""
    slots = slots_in_order(arrays, spec.num_objects)
    codes = np.take_along_axis(arrays["shape"], slots, axis=1).tolist()
    found = ["_".join(Shape(code).name.lower() for code in row) for row in codes]
    named = np.array(spec.scenario.strata())[arrays["stratum"]]
    return none_wrong("shapes are those of the stratum", np.flatnonzero(np.array(found) != named).tolist())


def level(name: str, values: np.ndarray, labels: Mapping[float, str], *, draws: int) -> Check:
    """Whether each value has an equal share of `draws` independent draws."""
    share = {label: float(np.isclose(values, value).mean()) for value, label in labels.items()}
    equal = 1 / len(share)
    passed = all(abs(value - equal) <= tolerance(equal, draws) for value in share.values())
    return Check(f"share of {name}", "  ".join(f"{label} {value:.1%}" for label, value in share.items()), passed)


def trajectories(arrays: Arrays, spec: DatasetSpec | ExternalSpec) -> Iterator[Check]:
    """How far apart the distributions of paths in CD are under two values of an object's own confounder."""
    for name, paths in paths_per_value(arrays, spec).items():
        samples = list(paths.values())
        if len(samples) > 1 and min(map(len, samples)) > 0:
            apart = max(ks_2samp(samples[0], other).statistic for other in samples[1:])
            limit = FURTHEST + 1 / np.sqrt(min(map(len, samples)))  # chance adds to it in tiny sets
            found = f"apart by {apart:.2f} ≤ {limit:.2f} (Kolmogorov-Smirnov)"
            yield Check(f"paths in CD per {name}", found, bool(apart <= limit))


def paths_per_value(arrays: Arrays, spec: DatasetSpec | ExternalSpec) -> dict[str, dict[float, np.ndarray]]:
    """Confounder -> value -> how far objects with that value are from their start in CD, averaged over time, metres.

    Per object in the scenario's order where this has a meaning (collision: moving, static), else over all objects.
    """
    moved, presence = mean_distance(arrays)[:, 1], arrays["presence"][:, 1]
    places = [(f" of object {k}", arrays["object_index"] == k) for k in range(spec.num_objects)]
    return {
        name + place: {
            value: moved[presence & chosen & np.isclose(arrays[name], value)]
            for value in getattr(spec.scenario.confounders, name)
        }
        for place, chosen in (places if spec.scenario.num_cells() > 1 else [("", presence)])
        for name in ("mass", "friction", "restitution")
    }
