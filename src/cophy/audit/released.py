"""Checks of released data: what their files contain, whatever generated them."""

from collections.abc import Iterator

import numpy as np

from cophy.audit.checks import Check, check_confounder_shares, check_distances, check_positions, check_stability
from cophy.dataset.difficulty import stands
from cophy.dataset.shards import Arrays, Sharded
from cophy.dataset.splits import SPLITS

CHANGED_M = 1e-4  # ours: float32 at a few metres is exact to 1e-6, and no do-operation is this small
NOT_APPLICABLE = {
    "twins": "the data have no twins",
    "regenerated from the seed": "the data are from another generator",
    "resimulated, AB identifies CD": "the data's solver, sizes and walls are not known",
    "energy": "the data's solver, sizes and walls are not known",
}


def audit_released(arrays: Arrays, spec: Sharded) -> Iterator[Check]:
    """Yield all checks that apply to the listed experiments of an index, and name those that do not."""
    result = f"{len(arrays['split'])} of {spec.num_experiments} folders; the others are broken, empty or in no list"
    yield Check("experiments that are listed and complete", result, True)
    counts = np.bincount(arrays["split"], minlength=len(SPLITS))
    yield Check("train : val : test, by the lists", " : ".join(map(str, counts)), bool(counts.all()))
    yield _check_copies(arrays)
    yield from _check_do_operations(arrays)
    yield from check_positions(arrays, spec.scenario.object_size_m)  # objects are 1 m large, as ours, in all formats
    yield from check_confounder_shares(arrays, spec.scenario, 1)
    if spec.scenario.statics is not None:
        standing = stands(arrays, spec.scenario.statics.fallen_distance)[:, 1]
        yield from check_stability(arrays, standing, spec.num_objects)
    else:
        yield from check_distances(arrays, spec)
    for name, reason in NOT_APPLICABLE.items():
        yield Check(name, f"does not apply: {reason}", True)


def _check_copies(arrays: Arrays) -> Check:
    """Check that no two splits contain the same A and C, to the last bit."""
    start = np.ascontiguousarray(arrays["states"][:, :, 0]).reshape(len(arrays["split"]), -1)
    _, scene = np.unique(start, axis=0, return_inverse=True)
    repeated = np.flatnonzero(np.bincount(scene) > 1)
    across = sum(len(np.unique(arrays["split"][scene == copy])) > 1 for copy in repeated)
    return Check("scenes that are in two splits", str(across), across == 0)


def _check_do_operations(arrays: Arrays) -> Iterator[Check]:
    """Check that C differs from A in one object, visibly, and in nothing else."""
    first, second = arrays["states"][:, 0, 0], arrays["states"][:, 1, 0]
    moved = np.abs(first[..., :7] - second[..., :7]).max(axis=-1) > CHANGED_M
    wrong = moved.sum(axis=1) != 1
    result = f"fails in {wrong.sum()}" if wrong.any() else "yes"
    yield Check("C equals A except for one object", result, not wrong.any())
    stays = arrays["presence"].all(axis=1)
    accelerated = (np.abs(first[..., 7:] - second[..., 7:]).max(axis=-1) > CHANGED_M) & stays
    result = f"fails in {accelerated.any(axis=1).sum()}" if accelerated.any() else "yes"
    yield Check("initial velocities of C are those of A", result, not accelerated.any())
    removed = arrays["presence"].sum(axis=2)[:, 0] - arrays["presence"].sum(axis=2)[:, 1]
    offset = np.linalg.norm(arrays["do_offset"], axis=1)[removed == 0]
    result = "-"
    if len(offset):
        result = f"{(removed > 0).mean():.1%} removals; displaced by {np.median(offset):.2f} m (median)"
    yield Check("do-operations", result, bool((removed <= 1).all()))
