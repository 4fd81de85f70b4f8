"""Twins share all but confounders, differ in both outcomes, and stay on one side of the split, and of †."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.checks import Arrays, Check, none_wrong
from cophy.dataset.audit.first_frames import slots_in_order
from cophy.dataset.difficulty import twin_differences
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import split_of_experiments
from cophy.scenario.search.held_out import problems

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
    if spec.scenario.statics is not None:
        yield _held_out(arrays, spec)
    in_place = np.array_equal(arrays["split"], split_of_experiments(spec.num_experiments, spec.data_seed))
    shares = " : ".join(f"{share:.2f}" for share in np.bincount(arrays["split"], minlength=3) / len(arrays["split"]))
    yield Check("train : val : test, by twin pair", shares, in_place)


def _prescribed(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Every experiment has the configuration, do-operation and cell that its index stands for, which keeps them level; `seen` too."""
    seen = spec.scenario.seen_configurations(spec.num_objects, spec.data_seed)
    wrong = np.flatnonzero(arrays["seen"] != (True if seen is None else seen[arrays["configuration"]])).tolist()
    for row in range(0, len(arrays["twin"]), 2):
        assignment = spec.scenario.assignment(spec.num_objects, data_seed=spec.data_seed, pair=int(arrays["twin"][row]))
        expected = (assignment.first, assignment.do_operation, assignment.cell)
        found = tuple(int(arrays[name][row]) for name in ("configuration", "do_operation", "cell"))
        if found != expected or int(arrays["configuration"][row + 1]) not in assignment.seconds:
            wrong.append(row)
    return none_wrong("confounders and do-operation are those of the index", wrong)


def _held_out(arrays: Arrays, spec: DatasetSpec) -> Check:
    """No masses and gravity of the half that † splits train on are in the other half: not turned, mirrored or scaled either."""
    mass = np.take_along_axis(arrays["mass"], slots_in_order(arrays, spec.num_objects), axis=1).astype(float)
    gravity = arrays["gravity"][:, :2].astype(float)
    found = problems(mass, gravity, spec.scenario.symmetries())
    seen, unseen = ({*map(tuple, found[arrays["seen"] == half].tolist())} for half in (True, False))
    numbers = f"{len(seen)} and {len(unseen)}, {len(seen & unseen)} in both"
    return Check("masses × gravity seen and unseen (†), up to symmetry and scale", numbers, not seen & unseen)
