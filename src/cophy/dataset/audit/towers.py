"""What only towers have: labels, and outcomes balanced for every value of every confounder (paper Sec. 3, Fig. 3)."""

from collections.abc import Iterator

import numpy as np

from cophy.dataset.audit.check import Arrays, Check, none_wrong, tolerance
from cophy.dataset.audit.geometry import geometry_of, slots_in_order
from cophy.dataset.audit.outcomes import stands
from cophy.dataset.spec import DatasetSpec
from cophy.scenario.stability import tower_margins


def towers(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Labels against the trajectories, and stability of CD per value of each confounder (paper Fig. 3)."""
    standing = stands(arrays, spec.scenario.fallen_distance)  # type: ignore[attr-defined]
    words = np.where(standing, "stands", "falls")
    right = (
        np.char.add(np.char.add(words[:, 0], "_"), words[:, 1]) == np.array(spec.scenario.strata())[arrays["stratum"]]
    )
    yield Check("labels agree with the trajectories", f"{right.mean():.1%}", bool(right.all()))
    alike = np.flatnonzero((standing[::2] == standing[1::2]).any(axis=1))
    yield none_wrong("twins have opposite outcomes, AB and CD", (2 * alike).tolist())
    yield _statics(arrays, spec, standing)
    yield _agreement(arrays, spec)
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        yield stability(name, arrays["gravity"][:, axis], standing[:, 1])
    for level in range(spec.num_objects):
        slot = arrays["object_index"] == level
        for name in ("mass", "friction"):
            yield stability(f"{name} of block {level}", arrays[name][slot], standing[:, 1])


def _statics(arrays: Arrays, spec: DatasetSpec, standing: np.ndarray) -> Check:
    """Every tower, of AB and of CD, stands or falls as statics say of its stored geometry under its own confounders."""
    mass, gravity_xy = spec.scenario.confounders.masses_and_gravities(spec.num_objects)
    slots = slots_in_order(arrays, spec.num_objects)
    own = np.concatenate([np.take_along_axis(arrays["mass"], slots, axis=1), arrays["gravity"][:, :2]], axis=1)
    column = np.abs(own[:, None] - np.concatenate([mass, gravity_xy], axis=1)).sum(axis=-1).argmin(axis=1)
    right = [
        np.take_along_axis(stand_on_paper(arrays, spec, sequence), column[:, None], axis=1)[:, 0]
        == standing[:, sequence]
        for sequence in (0, 1)
    ]
    share = np.mean(right)
    return Check("statics agree, under the stored masses and gravity", f"{share:.1%}", bool(share == 1))


def _agreement(arrays: Arrays, spec: DatasetSpec) -> Check:
    """Of all masses and gravities under which A stands too, how many share the CD of an experiment whose A stands.

    By statics, from the stored geometry. Where it is below 1, a standing AB makes the true CD likely, not certain.
    """
    names = np.array(spec.scenario.strata())[arrays["stratum"]]
    rows = np.char.startswith(names, "stands")
    observed, counterfactual = (stand_on_paper(arrays, spec, sequence)[rows] for sequence in (0, 1))
    outcome = np.char.endswith(names[rows], "stands")[:, None]
    shares = (observed & (counterfactual == outcome)).sum(axis=1) / observed.sum(axis=1).clip(min=1)
    needed = spec.scenario.min_agreement  # type: ignore[attr-defined]
    found = f"mean {shares.mean():.1%}, least {shares.min():.1%}, certain in {(shares == 1).mean():.1%}"
    return Check("a standing AB speaks for the true CD", found, bool(shares.min() >= needed - 0.02))


def stand_on_paper(arrays: Arrays, spec: DatasetSpec, sequence: int) -> np.ndarray:
    """(experiment, configuration) whether A, or C, stands under each combination of masses and gravity, by statics."""
    mass, gravity_xy = spec.scenario.confounders.masses_and_gravities(spec.num_objects)
    tower = geometry_of(arrays, sequence, spec.num_objects)
    xy, yaw = tower.position[..., :2], np.arctan2(tower.axis[..., 1], tower.axis[..., 0])
    levels, tilt = tower.presence.sum(axis=1), gravity_xy / -spec.scenario.gravity_z
    found = np.zeros((len(xy), len(mass)), dtype=bool)
    for count in np.unique(levels).tolist():
        rows, size_m = levels == count, spec.scenario.object_size_m
        found[rows] = tower_margins(xy[rows, :count], yaw[rows, :count], mass[:, :count], tilt, size_m=size_m) > 0
    return found


def stability(name: str, values: np.ndarray, standing: np.ndarray) -> Check:
    """Whether half of the towers stand, for each value."""
    share = {float(value): float(standing[values == value].mean()) for value in np.unique(values)}
    passed = all(abs(s - 0.5) <= tolerance(0.5, (values == value).sum()) for value, s in share.items())
    return Check(f"CD stands, per {name}", "  ".join(f"{value:g}: {s:.1%}" for value, s in share.items()), passed)
