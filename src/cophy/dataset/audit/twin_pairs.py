"""Twins share all but confounders, differ in both outcomes, and stay on one side of the split."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.checks import Arrays, Check, none_wrong
from cophy.dataset.difficulty import twin_differences
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import split_of_experiments
from cophy.scenario.search.assignment import seen_configurations

SHARED_BY_TWINS = (
    "twin",
    "split",
    "shape",
    "object_index",
    "presence",
    "do_operation",
    "do_slot",
    "do_offset",
    "background_seed",
)


def twins(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """All checks on pairs of twins."""
    differing = [name for name in SHARED_BY_TWINS if (arrays[name][::2] != arrays[name][1::2]).any()]
    first, second = arrays["states"][::2], arrays["states"][1::2]
    if (first[:, :, 0] != second[:, :, 0]).any():
        differing.append("states at t = 0")
    yield Check("twins share all but confounders", ", ".join(differing) or "yes", not differing)
    smallest = twin_differences(arrays).min()
    needed = spec.scenario.min_difference
    yield Check(
        "smallest difference of twins, AB and CD", f"{smallest:.3f} m ≥ {needed} m", bool(smallest >= needed - 1e-4)
    )
    yield _prescribed(arrays, spec)
    in_place = np.array_equal(arrays["split"], split_of_experiments(spec.num_experiments, spec.data_seed))
    shares = " : ".join(f"{share:.2f}" for share in np.bincount(arrays["split"], minlength=3) / len(arrays["split"]))
    yield Check("train : val : test, by twin pair", shares, in_place)


def _prescribed(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Every experiment has the configuration, do-operation and cell that its index stands for, which keeps them level; `seen` too."""
    count = spec.scenario.confounders.num_configurations(spec.num_objects)
    unseen = arrays["seen"] != seen_configurations(count, spec.data_seed)[arrays["configuration"]]
    wrong = np.flatnonzero(unseen).tolist()
    for row in range(0, len(arrays["twin"]), 2):
        assignment = spec.scenario.assignment(spec.num_objects, data_seed=spec.data_seed, pair=int(arrays["twin"][row]))
        expected = (assignment.first, assignment.do_operation, assignment.cell)
        found = tuple(int(arrays[name][row]) for name in ("configuration", "do_operation", "cell"))
        if found != expected or int(arrays["configuration"][row + 1]) not in assignment.seconds:
            wrong.append(row)
    return none_wrong("confounders and do-operation are those of the index", wrong)
