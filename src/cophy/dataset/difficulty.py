"""How hard each experiment is: how near its outcomes are to other ones, and how much the confounders matter.

Everything follows from the stored states; nothing of it is stored.
"""

import numpy as np

from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import stored_towers
from cophy.scenario.statics import joint_margins


def difficulty(arrays: dict[str, np.ndarray], spec: DatasetSpec) -> dict[str, np.ndarray]:
    """Name -> (experiment,) values of a whole dataset (`States.load`).

    - cell, do_operation: names of the cell and of the kind of do-operation.
    - twins (where twins have other cells): names of both twins' cells.
    - displacement: how far the do-operation moves its object, metres; NaN where it removes one.
    - observed_difference, counterfactual_difference: how far AB, or CD, is from the twin's, metres. A small observed one
      makes the confounders hard to tell; a small counterfactual one makes them matter little.
    - observed_margin, counterfactual_margin (towers): by statics under the true confounders, how far the centre of mass
      of A, or C, is from where the tower's outcome flips, metres (of a tower that falls, a lower bound); small is hard.
    """
    removed = arrays["presence"][:, 0].sum(axis=1) > arrays["presence"][:, 1].sum(axis=1)
    observed, counterfactual = np.repeat(twin_differences(arrays), 2, axis=0).T
    values = {
        "cell": np.array(spec.scenario.cells())[arrays["cell"]],
        "do_operation": np.array(spec.scenario.do_operations)[arrays["do_operation"]],
        "displacement": np.where(removed, np.nan, np.linalg.norm(arrays["do_offset"], axis=1)),
        "observed_difference": observed,
        "counterfactual_difference": counterfactual,
    }
    if (twins := _cells_of_both(values["cell"])) is not None:
        values["twins"] = twins
    if spec.scenario.statics is not None:
        margins = np.abs(true_margins(arrays, spec))
        values |= {"observed_margin": margins[:, 0], "counterfactual_margin": margins[:, 1]}
    return values


def _cells_of_both(cell: np.ndarray) -> np.ndarray | None:
    """(experiment,) names of both twins' cells; None where twins share theirs."""
    pairs = cell.reshape(-1, 2)
    if (pairs[:, 0] == pairs[:, 1]).all():
        return None
    return np.repeat([" or ".join(sorted(pair)) for pair in pairs.tolist()], 2)


def twin_differences(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """(pair, 2) trajectory distance in metres between the AB, and between the CD, of twins.

    As `trajectory_distance`: averaged over time, of the object that differs most.
    """
    apart = arrays["states"][::2, ..., :3] - arrays["states"][1::2, ..., :3]
    distance = np.linalg.norm(apart, axis=-1).mean(axis=2)
    return np.asarray(np.where(arrays["presence"][::2], distance, 0.0).max(axis=-1))


def true_margins(arrays: dict[str, np.ndarray], spec: DatasetSpec) -> np.ndarray:
    """(experiment, 2) margin (see `TowerStatics.margins`) of A and of C under the true confounders, metres; positive: it stands."""
    xy, yaw, num_levels, mass, tilt = stored_towers(arrays, spec.num_objects)
    margins = np.empty(num_levels.shape)
    for sequence in (0, 1):
        for k in np.unique(num_levels[:, sequence]).tolist():
            rows = np.flatnonzero(num_levels[:, sequence] == k)
            under, own = np.unique(np.hstack([mass[rows, :k], tilt[rows]]), axis=0, return_inverse=True)
            blocks = xy[rows, sequence, :k], yaw[rows, sequence, :k]
            of_all = joint_margins(*blocks, under[:, :k], under[:, k:], size_m=spec.scenario.object_size_m).min(axis=-1)
            margins[rows, sequence] = of_all[np.arange(len(rows)), own]
    return margins
