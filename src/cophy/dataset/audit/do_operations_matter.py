"""D is another than B: what the do-operation changed has to be foreseen, copying B is wrong."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.checks import Arrays, Check
from cophy.dataset.spec import DatasetSpec

ROUNDING_TOLERANCE_M = 1e-4  # stored states are rounded


def do_operations_matter(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """In how many experiments the do-operation matters; in all where the search promises it (see `significant_effect_m`)."""
    share, apart = matters(arrays, spec), matters(arrays, spec, acted_on=False)
    found = f"in {share:.1%} of experiments; in {apart:.1%} to an object that it does not act on"
    yield Check("the do-operation matters", found, spec.scenario.significant_effect_m is None or share == 1)


def matters(arrays: Arrays, spec: DatasetSpec, *, acted_on: bool = True) -> float:
    """Share of experiments in which the D of some object that remains differs significantly from its B.

    Args:
        arrays: of the dataset.
        spec: of the dataset.
        acted_on: whether the object that the do-operation displaces counts.
    """
    threshold_m = spec.scenario.significant_effect_m or spec.scenario.min_difference
    position = arrays["states"][..., :3]
    distance = np.linalg.norm(position[:, 1] - position[:, 0], axis=-1).mean(axis=1)
    counts = arrays["presence"][:, 1].copy()
    if not acted_on:
        counts[np.arange(len(counts)), arrays["do_slot"]] = False
    furthest = np.where(counts, distance, 0.0).max(axis=1)
    return float((furthest >= threshold_m - ROUNDING_TOLERANCE_M).mean())
