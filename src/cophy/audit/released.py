"""What can be checked of data that others made: not how they were found, but what they say."""

from collections.abc import Iterator

import numpy as np

from cophy.audit.checks import Arrays, Check
from cophy.audit.data import level, places, stability_per_value, trajectories
from cophy.dataset.features import stands
from cophy.dataset.shards import Sharded
from cophy.dataset.splits import SPLITS

SAME_TOLERANCE_M = 1e-4  # ours: float32 at a few metres is exact to 1e-6, and no do-operation is this small
NOT_APPLICABLE = {
    "twins": "the data have none: each experiment stands for itself",
    "made again from the seed": "they are not of this generator",
    "simulated again, AB identifies CD": "their solver, sizes and walls are not known",
    "energy": "likewise",
}


def audit_released(arrays: Arrays, spec: Sharded) -> Iterator[Check]:
    """All checks that apply to the listed experiments of an index, and those that do not."""
    found = f"{len(arrays['split'])} of {spec.num_experiments} folders; the others are broken, empty or in no list"
    yield Check("experiments that are listed and whole", found, True)
    counts = np.bincount(arrays["split"], minlength=len(SPLITS))
    yield Check("train : val : test, by the lists", " : ".join(map(str, counts)), bool(counts.all()))
    yield _copies(arrays)
    yield from _do_operations(arrays)
    yield from places(arrays, spec.scenario.object_size_m)  # objects are 1 m large, as ours, in all formats
    yield from _balance(arrays, spec)
    if spec.scenario.statics is not None:
        standing = stands(arrays, spec.scenario.statics.fallen_distance)[:, 1]
        yield from stability_per_value(arrays, standing, spec.num_objects)
    else:
        yield from trajectories(arrays, spec)
    for name, why in NOT_APPLICABLE.items():
        yield Check(name, f"does not apply: {why}", True)


def _copies(arrays: Arrays) -> Check:
    """The same A and C, to the last bit, under another id of another split."""
    start = np.ascontiguousarray(arrays["states"][:, :, 0]).reshape(len(arrays["split"]), -1)
    _, group = np.unique(start, axis=0, return_inverse=True)
    splits = [set(arrays["split"][group == copy].tolist()) for copy in np.flatnonzero(np.bincount(group) > 1)]
    across = sum(len(found) > 1 for found in splits)
    return Check("scenes that are in two splits", str(across), across == 0)


def _do_operations(arrays: Arrays) -> Iterator[Check]:
    """At t = 0, C differs from A in one object, visibly, and in nothing else."""
    first, second = arrays["states"][:, 0, 0], arrays["states"][:, 1, 0]
    differs = np.abs(first[..., :7] - second[..., :7]).max(axis=-1) > SAME_TOLERANCE_M
    wrong = differs.sum(axis=1) != 1
    yield Check("C is A but for one object", f"not in {wrong.sum()}" if wrong.any() else "yes", not wrong.any())
    stays = arrays["presence"].all(axis=1)
    other = (np.abs(first[..., 7:] - second[..., 7:]).max(axis=-1) > SAME_TOLERANCE_M) & stays
    yield Check("initial velocities of C are those of A", f"not in {other.any(axis=1).sum()}", not other.any())
    removed = arrays["presence"].sum(axis=2)[:, 0] - arrays["presence"].sum(axis=2)[:, 1]
    offset = np.linalg.norm(arrays["do_offset"], axis=1)[removed == 0]
    found = (
        f"{(removed > 0).mean():.1%} removals; displaced by {np.median(offset):.2f} m (median)" if len(offset) else "-"
    )
    yield Check("do-operations", found, bool((removed <= 1).all()))


def _balance(arrays: Arrays, spec: Sharded) -> Iterator[Check]:
    """Confounder values are level, up to chance and BALANCE_TOLERANCE."""
    present, grid = arrays["presence"][:, 0], spec.scenario.confounders
    values = {name: arrays[name][present] for name in ("mass", "friction", "restitution")}
    values |= {name: arrays["gravity"][:, axis] for axis, name in enumerate(("gravity_x", "gravity_y"))}
    for name, found in values.items():
        labels = {value: f"{value:g}" for value in getattr(grid, name)}
        if np.isnan(found).any():
            yield Check(f"share of {name}", "does not apply: unknown", True)
        else:
            yield level(name, found, labels, draws=len(found) // len(spec.scenario.cells()))
