"""What can be checked of data that others made: not how they were found, but what they say."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.check import Arrays, Check
from cophy.dataset.audit.shares import level, trajectories
from cophy.dataset.audit.states import DEEPEST
from cophy.dataset.audit.towers import stability
from cophy.dataset.external.spec import ExternalSpec
from cophy.dataset.splits import SPLITS

SAME_M = 1e-4  # ours: float32 at a few metres is exact to 1e-6, and no do-operation is this small
NOT_APPLICABLE = {
    "twins": "the data have none: each experiment stands for itself",
    "made again from the seed": "they are not of this generator",
    "simulated again, AB identifies CD": "their solver, sizes and walls are not known",
    "energy": "likewise",
}


def audit_external(arrays: Arrays, spec: ExternalSpec) -> Iterator[Check]:
    """All checks that apply to the listed experiments of an index, and those that do not."""
    found = f"{len(arrays['split'])} of {spec.num_experiments} folders; the others are broken, empty or in no list"
    yield Check("experiments that are listed and whole", found, True)
    counts = np.bincount(arrays["split"], minlength=len(SPLITS))
    yield Check("train : val : test, by the lists", " : ".join(map(str, counts)), bool(counts.all()))
    yield _copies(arrays)
    yield from _do_operations(arrays)
    yield from _places(arrays, spec)
    yield from _balance(arrays, spec)
    if spec.scenario.name == "blocktower":
        yield from _towers(arrays, spec)
    else:
        yield from trajectories(arrays, spec)
    for name, why in NOT_APPLICABLE.items():
        yield Check(name, f"does not apply: {why}", True)


def fallen(arrays: Arrays, spec: ExternalSpec) -> np.ndarray:
    """(experiment, 2) whether the towers of AB and CD fall."""
    position = arrays["states"][..., :3]
    moved = np.linalg.norm(position - position[:, :, :1], axis=-1).max(axis=(2, 3))
    return moved >= spec.scenario.fallen_distance  # type: ignore[attr-defined]


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
    differs = np.abs(first[..., :7] - second[..., :7]).max(axis=-1) > SAME_M
    wrong = differs.sum(axis=1) != 1
    yield Check("C is A but for one object", f"not in {wrong.sum()}" if wrong.any() else "yes", not wrong.any())
    stays = arrays["presence"].all(axis=1)
    other = (np.abs(first[..., 7:] - second[..., 7:]).max(axis=-1) > SAME_M) & stays
    yield Check("initial velocities of C are those of A", f"not in {other.any(axis=1).sum()}", not other.any())
    removed = arrays["presence"].sum(axis=2)[:, 0] - arrays["presence"].sum(axis=2)[:, 1]
    offset = np.linalg.norm(arrays["do_offset"], axis=1)[removed == 0]
    found = (
        f"{(removed > 0).mean():.1%} removals; displaced by {np.median(offset):.2f} m (median)" if len(offset) else "-"
    )
    yield Check("do-operations", found, bool((removed <= 1).all()))


def _places(arrays: Arrays, spec: ExternalSpec) -> Iterator[Check]:
    """Objects are as large as ours in all layouts: 1 m."""
    size, nearest, lowest = spec.scenario.object_size_m, np.inf, np.inf
    others = ~np.eye(spec.scenario.num_slots, dtype=bool)
    for rows, present in zip(arrays["states"][..., :3], arrays["presence"], strict=True):
        both = present[:, :, None] & present[:, None, :] & others
        distance = np.linalg.norm(rows[:, :, :, None] - rows[:, :, None, :], axis=-1).min(axis=1)
        nearest = min(nearest, distance[both].min(initial=np.inf))
        lowest = min(lowest, rows[..., 2].swapaxes(1, 2)[present].min())
    limits = (1 - DEEPEST) * size, (0.5 - DEEPEST) * size
    yield Check("objects are apart, centres at least", f"{nearest:.3f} m ≥ {limits[0]:g} m", bool(nearest >= limits[0]))
    yield Check(
        "objects are above the floor, centres at least", f"{lowest:.3f} m ≥ {limits[1]:g} m", lowest >= limits[1]
    )


def _balance(arrays: Arrays, spec: ExternalSpec) -> Iterator[Check]:
    """Confounder values are level, up to chance and BALANCE."""
    present, grid = arrays["presence"][:, 0], spec.scenario.confounders
    values = {name: arrays[name][present] for name in ("mass", "friction", "restitution")}
    values |= {name: arrays["gravity"][:, axis] for axis, name in enumerate(("gravity_x", "gravity_y"))}
    for name, found in values.items():
        labels = {value: f"{value:g}" for value in getattr(grid, name)}
        if np.isnan(found).any():
            yield Check(f"share of {name}", "does not apply: unknown", True)
        else:
            yield level(name, found, labels, draws=len(found) // spec.scenario.num_cells())


def _towers(arrays: Arrays, spec: ExternalSpec) -> Iterator[Check]:
    """Stability of CD per value of each confounder (paper Fig. 3)."""
    stands = ~fallen(arrays, spec)[:, 1]
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        if not np.isnan(arrays["gravity"][:, axis]).any():
            yield stability(name, arrays["gravity"][:, axis], stands)
    for place in range(spec.num_objects):
        slot = arrays["object_index"] == place
        for name in ("mass", "friction"):
            if not np.isnan(arrays[name][slot]).any():
                yield stability(f"{name} of block {place}", arrays[name][slot], stands)
