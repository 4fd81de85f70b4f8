"""Is a dataset what it claims to be? Each check looks at the stored arrays alone."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from cophy.dataset.spec import DatasetSpec
from cophy.dataset.splits import split_of_experiments
from cophy.scenario.stability import tower_margins

BALANCE = 0.05  # paper Sec. 3: 50 ± 5 % of the counterfactual outcomes are stable
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

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Check:
    """One line of an audit: what was looked at, what was found, and whether that is sound."""

    name: str
    found: str
    passed: bool


def audit(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """All checks on a loaded dataset (loading it has already verified every checksum)."""
    yield _states(arrays)
    yield from _twins(arrays, spec)
    yield from _shares(arrays, spec)
    if spec.scenario.name == "blocktower":
        yield from _towers(arrays, spec)
    simulations = arrays["pair_simulations"][::2].sum() / len(arrays["twin"])
    yield Check("simulations per experiment", f"{simulations:.2f}", True)


def _states(arrays: Arrays) -> Check:
    finite = bool(np.isfinite(arrays["states"]).all())
    absent = ~arrays["presence"]
    empty = not arrays["states"].swapaxes(2, 3)[absent].any()
    return Check("states are finite, empty slots zero", "yes" if finite and empty else "no", finite and empty)


def _twins(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    differing = [name for name in SHARED_BY_TWINS if (arrays[name][::2] != arrays[name][1::2]).any()]
    first, second = arrays["states"][::2], arrays["states"][1::2]
    if (first[:, :, 0] != second[:, :, 0]).any():
        differing.append("states at t = 0")
    yield Check("twins share all but confounders", ", ".join(differing) or "yes", not differing)
    distance = np.linalg.norm(first[..., :3] - second[..., :3], axis=-1).mean(axis=2)
    smallest = np.where(arrays["presence"][::2], distance, 0.0).max(axis=-1).min()
    needed = spec.scenario.min_difference
    yield Check(
        "smallest difference of twins, AB and CD", f"{smallest:.3f} m ≥ {needed} m", bool(smallest >= needed - 1e-4)
    )
    in_place = np.array_equal(arrays["split"], split_of_experiments(spec.num_experiments, spec.seed))
    shares = " : ".join(f"{share:.2f}" for share in np.bincount(arrays["split"], minlength=3) / len(arrays["split"]))
    yield Check("train : val : test, by twin pair", shares, in_place)


def _shares(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
    """Frequencies of strata, do-operations and confounder values: equal, up to chance and BALANCE."""
    scenario, count, cells = spec.scenario, len(arrays["twin"]), spec.scenario.num_cells()
    strata, kinds, grid = scenario.strata(), scenario.do_operations, scenario.confounders
    yield _level("strata", arrays["stratum"], dict(enumerate(strata)), draws=count)
    yield _level("do-operations", arrays["do_operation"], dict(enumerate(kinds)), draws=count // (2 * cells))
    present = arrays["object_index"] >= 0
    # each configuration that is drawn serves one experiment per cell
    for name in ("mass", "friction", "restitution"):
        values = {value: f"{value:g}" for value in getattr(grid, name)}
        yield _level(name, arrays[name][present], values, draws=present.sum() // cells)
    for axis, name in enumerate(("gravity_x", "gravity_y")):
        values = {value: f"{value:g}" for value in getattr(grid, name)}
        yield _level(name, arrays["gravity"][:, axis], values, draws=count // cells)


def _level(name: str, values: np.ndarray, labels: Mapping[float, str], *, draws: int) -> Check:
    share = {label: float(np.isclose(values, value).mean()) for value, label in labels.items()}
    equal = 1 / len(share)
    passed = all(abs(value - equal) <= _tolerance(equal, draws) for value in share.values())
    return Check(f"share of {name}", "  ".join(f"{label} {value:.1%}" for label, value in share.items()), passed)


def _towers(arrays: Arrays, spec: DatasetSpec) -> Iterator[Check]:
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
        yield _stability(name, arrays["gravity"][:, axis], stands[:, 1])
    for level in range(spec.num_objects):
        slot = arrays["object_index"] == level
        for name in ("mass", "friction"):
            yield _stability(f"{name} of block {level}", arrays[name][slot], stands[:, 1])


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


def _stability(name: str, values: np.ndarray, stands: np.ndarray) -> Check:
    share = {float(value): float(stands[values == value].mean()) for value in np.unique(values)}
    passed = all(abs(s - 0.5) <= _tolerance(0.5, (values == value).sum()) for value, s in share.items())
    return Check(f"CD stands, per {name}", "  ".join(f"{value:g}: {s:.1%}" for value, s in share.items()), passed)


def _tolerance(share: float, draws: int) -> float:
    """BALANCE, or three standard deviations of a share among `draws` independent draws where that is more (tiny sets)."""
    return max(BALANCE, 3 * float(np.sqrt(share * (1 - share) / draws)))
