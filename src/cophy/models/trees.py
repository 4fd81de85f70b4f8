"""Extra trees: a baseline without a network, from AB, A and C in a canonical frame.

There is one row per object of C. Its frame removes the symmetries of the scenario, so that equivalent experiments have equal
rows. Trees are fitted in each run and never stored.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from cophy.errors import CophyError
from cophy.models.baselines import ConfounderInput
from cophy.models.frames import canonical_matrices, octant
from cophy.models.layers import check_at_least, parse_option
from cophy.scenario import Collision, Scenario
from cophy.scenario.statics import TowerStatics, joint_margins
from cophy.types import CONFOUNDERS, HORIZONTAL, Batch, Inputs, Prediction, true_confounders

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesRegressor

LAST = 1e6  # metres; beyond any distance or height
MASS, (GRAVITY, _, AXIS) = CONFOUNDERS.index("mass"), HORIZONTAL  # columns of the confounders


class Trees(nn.Module):
    """Extremely randomised trees (Geurts et al., Machine Learning 2006) that predict D - C of one object from its `Rows`.

    Args:
        num_trees: Trees, of whose predictions the mean is taken.
        min_samples_leaf: Smallest number of rows in a leaf.
        confounders: `ground_truth` adds the true confounders, and for towers what statics says of A and C under them.

    Raises:
        CophyError: An argument is out of its range.
    """

    regressor: "ExtraTreesRegressor | None" = None
    scenario: Scenario
    statistics: tuple[Tensor, Tensor]

    def __init__(
        self, *, num_trees: int, min_samples_leaf: int, confounders: ConfounderInput | str | None = None
    ) -> None:
        super().__init__()
        check_at_least(1, num_trees=num_trees, min_samples_leaf=min_samples_leaf)
        if confounders is not None and parse_option(ConfounderInput, "confounders", confounders).width < len(
            CONFOUNDERS
        ):
            raise CophyError("model.confounders=without_pose: statics needs the yaw of the blocks; use ground_truth")
        self.num_trees, self.min_samples_leaf = num_trees, min_samples_leaf
        self.sees_confounders = confounders is not None

    def fit(self, train: Batch, scenario: Scenario, statistics: tuple[Tensor, Tensor], seed: int) -> None:
        """Fit the trees on the training split.

        Args:
            train: All of it.
            scenario: Determines the frames.
            statistics: Mean and standard deviation of each confounder, see `cophy.dataset.features.confounder_statistics`.
            seed: Of the trees.
        """
        from sklearn.ensemble import ExtraTreesRegressor  # takes half a second to import

        self.scenario, self.statistics = scenario, statistics
        rows = self._rows(train.inputs)
        motion = (train.targets.position - train.inputs.initial[:, None]).cpu().numpy()
        target = transformed(motion[rows.experiment, :, rows.slot, : scenario.task.metric_dims], rows.to_frame)
        is_true = train.targets.presence.cpu().numpy()[rows.experiment, rows.slot]  # a de-renderer can see too many
        # every split tries all features: with 30 % of them, the validation MSE of collisions is 0.083 m² instead of 0.067
        regressor = ExtraTreesRegressor(
            self.num_trees, min_samples_leaf=self.min_samples_leaf, n_jobs=1, random_state=seed
        )
        self.regressor = regressor.fit(rows.features[is_true], target[is_true].reshape(is_true.sum(), -1))

    def forward(self, inputs: Inputs) -> Prediction:
        """Predict D; coordinates that do not count stay as in C."""
        assert self.regressor is not None, "the trees are not fitted"
        position = inputs.initial[:, None].repeat(1, inputs.num_steps, 1, 1)
        rows, dims = self._rows(inputs), self.scenario.task.metric_dims
        if len(rows.slot):
            motion = self.regressor.predict(rows.features).reshape(len(rows.slot), inputs.num_steps, dims)
            motion = torch.from_numpy(transformed(motion, rows.to_frame.swapaxes(1, 2))).to(position)
            position[rows.experiment, :, rows.slot, :dims] += motion
        return Prediction(position)

    def _rows(self, inputs: Inputs) -> "Rows":
        rows = canonical(inputs, self.scenario, sees_confounders=self.sees_confounders)
        if not self.sees_confounders or self.scenario.statics is None:
            return rows
        statics = statics_features(inputs, self.scenario.statics, self.statistics)
        return rows._replace(features=np.hstack([rows.features, statics[rows.experiment]]))


class Rows(NamedTuple):
    """One row per object of C.

    Attributes:
        features: What the trees see, in the row's frame.
        experiment, slot: Indices of the object.
        to_frame: Rotation or reflection that takes (x, y) to the row's frame.
    """

    features: Float[np.ndarray, "row feature"]
    experiment: Int[np.ndarray, "row"]
    slot: Int[np.ndarray, "row"]
    to_frame: Float[np.ndarray, "row 2 2"]


def canonical(inputs: Inputs, scenario: Scenario, *, sees_confounders: bool = False) -> Rows:
    """Describe each object of C in a frame of its own.

    The object comes first, then the others (towers: from the ground up, else from near to far in C), then one that C lacks.
    Features of each: AB (the first two frames, one per second, the last), C, C - A, and presence in both; what is absent is
    zero. Frames:

    - Collisions: the origin is the object in C, the x axis the initial heading; in C the static object is on the left of it.
    - Balls: the origin is the centre of the arena. Its walls have the symmetries of a square, by which the initial heading
      of the ball lies between 0 and 45°.
    - Towers: the origin is below the lowest block of C; the mean displacement at the end of AB lies between 0 and 45°.

    Args:
        sees_confounders: Whether the true confounders of each object are features, too.
    """
    seen, present = inputs.observed_presence.cpu().numpy(), inputs.presence.cpu().numpy()
    observed = np.where(seen[:, None, :, None], inputs.observed.cpu().numpy(), 0).swapaxes(1, 2)
    initial = np.where(present[..., None], inputs.initial.cpu().numpy(), 0)
    experiment, slot = np.nonzero(present)
    own = initial[experiment, slot]
    if scenario.statics is not None:
        rank = initial[experiment, :, 2]
        lowest = np.where(present, initial[..., 2], LAST).argmin(axis=1)
        origin = initial[experiment, lowest[experiment]]
    else:
        rank = np.linalg.norm(initial[experiment] - own[:, None], axis=-1)
        origin = own if isinstance(scenario, Collision) else np.zeros_like(own)
    rank = np.where(present[experiment], rank, LAST + ~seen[experiment])
    rank[np.arange(len(slot)), slot] = -1  # itself
    objects = experiment[:, None], rank.argsort(axis=1, kind="stable")

    origin = origin * [1, 1, 0]  # heights count from the floor
    to_frame = frames_of(inputs, scenario)[experiment, slot]
    last = inputs.num_steps
    times = sorted({0, 1, *range(0, last, scenario.clock.frame_rate_hz), last})
    in_ab, in_c = seen[objects], present[objects]
    vectors = [
        (observed[:, :, times][objects] - origin[:, None, None]) * in_ab[..., None, None],
        (initial[objects] - origin[:, None]) * in_c[..., None],
        (initial - observed[:, :, 0])[objects] * (in_ab & in_c)[..., None],
    ]
    features = [transformed(each, to_frame)[..., : scenario.task.metric_dims] for each in vectors] + [in_ab, in_c]
    if sees_confounders:
        confounders = true_confounders(inputs).cpu().numpy()[objects] * in_ab[..., None]
        for columns in HORIZONTAL:
            confounders[..., columns] = transformed(confounders[..., columns], to_frame)
        features.append(confounders)
    flat = [each.reshape(len(slot), math.prod(each.shape[1:])).astype(np.float32) for each in features]
    return Rows(np.hstack(flat), experiment, slot, to_frame)


def frames_of(inputs: Inputs, scenario: Scenario) -> Float[np.ndarray, "batch slots 2 2"]:
    """Return the rotation or reflection that takes (x, y) to the frame of each object, see `canonical`."""
    if isinstance(scenario, Collision) or scenario.statics is not None:
        matrices = canonical_matrices(inputs, "blocktower" if scenario.statics is not None else "collision")
        return matrices[:, None].expand(*inputs.presence.shape, 2, 2).cpu().numpy()
    motion = (inputs.observed[:, 1] - inputs.observed[:, 0]) * inputs.observed_presence[..., None]
    return octant(motion[..., :2]).cpu().numpy()


def transformed(
    vectors: Float[np.ndarray, "row *any dims"], matrices: Float[np.ndarray, "row 2 2"]
) -> Float[np.ndarray, "row *any dims"]:
    """Apply the matrix of each row to x and y of its vectors."""
    xy = np.einsum("rij,r...j->r...i", matrices, vectors[..., :2])
    return np.concatenate([xy, vectors[..., 2:]], axis=-1)


def statics_features(
    inputs: Inputs, statics: TowerStatics, statistics: tuple[Tensor, Tensor]
) -> Float[np.ndarray, "batch feature"]:
    """Return how far A and C are from toppling under the true confounders, metres.

    Returns:
        For A, then for C: the margin of each joint from the ground up (0 above the tower), and the smallest one, which says
        whether the tower stands.
    """
    mean, deviation = statistics
    values = (true_confounders(inputs).cpu() * deviation + mean).numpy().astype(np.float64)
    mass, gravity, axis = values[..., MASS], values[..., GRAVITY], values[..., AXIS]
    features = []
    for tensor, presence in ((inputs.observed[:, 0], inputs.observed_presence), (inputs.initial, inputs.presence)):
        position, present = tensor.cpu().numpy().astype(np.float64), presence.cpu().numpy()
        blocks = np.arange(len(position))[:, None], np.where(present, position[..., 2], LAST).argsort(axis=1)
        tilt = gravity[blocks][:, 0] / -statics.gravity_z
        conditions = np.hstack([(mass * present)[blocks], tilt])
        yaw = np.arctan2(axis[..., 1], axis[..., 0])[blocks]
        margins, smallest = np.zeros_like(mass), np.full((len(mass), 1), LAST)
        for condition in np.unique(conditions, axis=0):
            towers = np.flatnonzero((conditions == condition).all(axis=1))
            masses = condition[None, :-2][:, condition[:-2] > 0]
            levels = masses.shape[1]
            xy = position[blocks][towers, :levels, :2]
            joints = joint_margins(xy, yaw[towers, :levels], masses, condition[None, -2:], size_m=statics.block_size)
            margins[towers, :levels] = joints[:, 0]
            smallest[towers] = joints[:, 0].min(axis=1, keepdims=True, initial=LAST)
        features += [margins, smallest]
    return np.hstack(features).astype(np.float32)
