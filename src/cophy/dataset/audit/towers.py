"""What only towers have: labels, and outcomes balanced for every value of every confounder (paper Sec. 3, Fig. 3)."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.check import Arrays, Check, tolerance
from cophy.dataset.spec import DatasetSpec
from cophy.scenario.stability import tower_margins


def towers(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Labels against the trajectories, and stability of CD per value of each confounder (paper Fig. 3)."""
    positions = arrays["states"][..., :3]
    moved = np.linalg.norm(positions - positions[:, :, :1], axis=-1).max(axis=(2, 3))
    stands = moved < spec.scenario.fallen_distance  # type: ignore[attr-defined]
    words = np.where(stands, "stands", "falls")
    right = (
        np.char.add(np.char.add(words[:, 0], "_"), words[:, 1]) == np.array(spec.scenario.strata())[arrays["stratum"]]
    )
    yield Check("labels agree with the trajectories", f"{right.mean():.1%}", bool(right.all()))
    yield _agreement(arrays, spec)
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        yield stability(name, arrays["gravity"][:, axis], stands[:, 1])
    for level in range(spec.num_objects):
        slot = arrays["object_index"] == level
        for name in ("mass", "friction"):
            yield stability(f"{name} of block {level}", arrays[name][slot], stands[:, 1])


def _agreement(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Of all masses and gravities under which A stands too, how many share the CD of an experiment whose A stands.

    By statics, from the stored geometry. Where it is below 1, a standing AB makes the true CD likely, not certain.
    """
    mass, gravity_xy = spec.scenario.confounders.masses_and_gravities(spec.num_objects)
    tilt = gravity_xy / -spec.scenario.gravity_z
    order = np.argsort(np.where(arrays["object_index"] < 0, spec.num_objects, arrays["object_index"]), axis=1)
    initial = np.take_along_axis(arrays["states"][:, :, 0], order[:, None, :, None], axis=2)
    xy, yaw = initial[..., :2], 2 * np.arctan2(initial[..., 5], initial[..., 6])
    present = np.take_along_axis(arrays["presence"][:, 1], order, axis=1).sum(axis=1)
    names = np.array(spec.scenario.strata())[arrays["stratum"]]
    share = []
    for kept in np.unique(present):
        rows = (present == kept) & np.char.startswith(names, "stands")
        levels = {0: spec.num_objects, 1: int(kept)}
        observed, counterfactual = (
            tower_margins(xy[rows, s, :k], yaw[rows, s, :k], mass[:, :k], tilt, size_m=spec.scenario.block_size) > 0  # type: ignore[attr-defined]
            for s, k in levels.items()
        )
        outcome = np.char.endswith(names[rows], "stands")[:, None]
        share.append((observed & (counterfactual == outcome)).sum(axis=1) / observed.sum(axis=1).clip(min=1))
    shares = np.concatenate(share)
    needed = spec.scenario.min_agreement  # type: ignore[attr-defined]
    found = f"mean {shares.mean():.1%}, least {shares.min():.1%}, certain in {(shares == 1).mean():.1%}"
    return Check("a standing AB speaks for the true CD", found, bool(shares.min() >= needed - 0.02))


def stability(name: str, values: np.ndarray, stands: np.ndarray) -> Check:
    """Whether half of the towers stand, for each value."""
    share = {float(value): float(stands[values == value].mean()) for value in np.unique(values)}
    passed = all(abs(s - 0.5) <= tolerance(0.5, (values == value).sum()) for value, s in share.items())
    return Check(f"CD stands, per {name}", "  ".join(f"{value:g}: {s:.1%}" for value, s in share.items()), passed)
