"""Hypotheses: predicts a tower under every combination of masses and gravity, and weighs the predictions by what AB shows.

It is not in the paper. A tower stands where, at every joint, the centre of mass of all that rests on it projects, along the tilted
gravity, inside the contact (`cophy.scenario.statics`). This is computed for A and C under every hypothesis h: each block is light or
heavy, and gravity has one of nine tilts. Which ratio of masses and which tilt is learned.

    statics of A under h --f, mean over blocks, g--> a_k;  motion of block k in AB under h: μ_k = W a_k
    weight of h = softmax_h Σ_k s(a_k, motion of k in AB, motion of k in AB - μ_k)
    statics of C under h --the same f, g, W--> motion of D under h;  D = C + its mean under these weights

f, g and s are MLPs that all blocks and hypotheses share, W is a matrix. Vectors are in the frame of the joint that is nearest to
toppling under h: its x axis is the normal of the edge over which the tower would topple. No weight depends on the number of blocks, and
a quarter turn turns the prediction. The network is trained by positions and stability in D alone: s learns what explains AB.

Contacts depend on the yaw of the blocks, which positions do not show. Without it, faces count as discs.
"""

from itertools import product
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import logsigmoid

from cophy.errors import CophyError
from cophy.models.baselines import rotate_quarter
from cophy.models.layers import check_at_least, check_positive, mlp, pack, unpack
from cophy.types import POSE_ANGLES, Inputs, Prediction

INITIAL_LOG_RATIO = 1.0  # ours: logarithm of heavy over light mass
INITIAL_TILT = 0.05  # ours: horizontal over vertical gravity; what it becomes may have either sign
# Ours, lengths in edges of a block:
NEAR = 0.1  # margins, accelerations and tilts of this size matter
SMALL = 0.05  # motions below it are seen linearly, larger ones by their logarithm
MAX_MARGIN = 1.0  # where there is no joint
LIMITS = (-2.5, 3.5)  # of all features: what is farther counts alike
NUM_FEATURES = 26  # of a block, see `describe`; two more with its yaw
EPSILON = 1e-8  # keeps divisors and the slope of square roots finite


class TowerHypotheses(NamedTuple):
    """Towers, and hypotheses of what positions do not show: the same for all of them, or others for each.

    Attributes:
        position: Centres, in edges of a block.
        presence: Which slots hold a block.
        yaw: Of the blocks, rad; None to count faces as discs.
        mass: Without a unit.
        tilt: Horizontal over vertical gravity.
    """

    position: Float[Tensor, "batch slots 3"]
    presence: Bool[Tensor, "batch slots"]
    yaw: Float[Tensor, "batch slots"] | None
    mass: Float[Tensor, "*batch hypotheses slots"]
    tilt: Float[Tensor, "*batch hypotheses 2"]


class Joints(NamedTuple):
    """Where the loads of towers bear. Joint k is the contact below block k; its load is block k and all above it.

    Attributes:
        margin: How far the load is inside both faces of the joint, in edges of a block; below zero, the joint fails.
        load_point: Where the load bears, (x, y) like all that follow.
        support: Centre of the block below; on the ground that of block k itself, whose face is then the whole contact.
        face: Centre of the face whose edge is the nearest.
        normal: Normal of this edge, outwards.
        load_mass: Mass of the load.
        above, below: Which other blocks belong to the load, and which are lower.
    """

    margin: Float[Tensor, "batch hypotheses slots"]
    load_point: Float[Tensor, "batch hypotheses slots 2"]
    support: Float[Tensor, "batch 1 slots 2"]
    face: Float[Tensor, "batch hypotheses slots 2"]
    normal: Float[Tensor, "batch hypotheses slots 2"]
    load_mass: Float[Tensor, "batch hypotheses slots"]
    above: Bool[Tensor, "batch slots slots"]
    below: Bool[Tensor, "batch slots slots"]


def find_joints(towers: TowerHypotheses) -> Joints:
    """Return the joints of towers under every hypothesis."""
    xy, z, present, yaw = towers.position[..., :2], towers.position[..., 2], towers.presence[:, None], towers.yaw
    below = (z[:, None] < z[:, :, None] - 0.5) & present  # (batch, block, other): the other is lower
    loads = (z[:, None] > z[:, :, None] - 0.5) & present  # the block itself, too
    load = loads[:, None] * towers.mass[..., None, :]
    load_mass = load.sum(dim=-1).clamp(min=EPSILON)
    share = load / load_mass[..., None]
    lever = torch.einsum("bhkj,bj->bhk", share, z) - z[:, None] + 0.5  # height of the load's centre above the joint
    load_point = torch.einsum("bhkj,bjx->bhkx", share, xy) + towers.tilt[..., None, :] * lever[..., None]

    itself = torch.eye(z.shape[1], dtype=torch.bool, device=z.device)
    lower = below | (itself & ~below.any(dim=2, keepdim=True))
    highest = torch.where(lower, z[:, None], -torch.inf).argmax(dim=2)
    support = xy.gather(1, highest[..., None].expand_as(xy))[:, None]
    block_distance, block_normal = nearest_edge(load_point - xy[:, None], yaw)
    support_distance, support_normal = nearest_edge(
        load_point - support, None if yaw is None else yaw.gather(1, highest)
    )
    is_block = (block_distance >= support_distance)[..., None]
    face = torch.where(is_block, xy[:, None], support)
    normal = torch.where(is_block, block_normal, support_normal)
    margin = torch.where(present, 0.5 - torch.maximum(block_distance, support_distance), MAX_MARGIN)
    return Joints(margin, load_point, support, face, normal, load_mass, loads & ~itself, below)


def yaw_of(pose: Float[Tensor, "batch slots 7"]) -> Float[Tensor, "batch slots"]:
    """Return the yaw of blocks between -45° and 45°, rad."""
    cos, sin = pose[..., POSE_ANGLES[4]].unbind(dim=-1)
    return torch.atan2(sin, cos) / 4


def nearest_edge(
    vectors: Float[Tensor, "batch hypotheses slots 2"], yaw: Float[Tensor, "batch slots"] | None
) -> tuple[Float[Tensor, "batch hypotheses slots"], Float[Tensor, "batch hypotheses slots 2"]]:
    """Return how far points are from the centre of a face towards its nearest edge, 0.5 on the edge, and the edge's normal.

    Without a yaw, the face is a disc.

    Args:
        vectors: From the centre to the point, in edges of a block.
        yaw: Of the face, rad.
    """
    if yaw is None:
        distance = vectors.square().sum(dim=-1).add(EPSILON).sqrt()
        return distance, vectors / distance[..., None]
    normal = torch.stack([yaw.cos(), yaw.sin()], dim=-1)[:, None].expand_as(vectors)
    along, across = (vectors * normal).sum(dim=-1), (vectors * rotate_quarter(normal)).sum(dim=-1)
    is_along = along.abs() > across.abs()
    distance = torch.where(is_along, along, across)
    return distance.abs(), torch.where(is_along[..., None], normal, rotate_quarter(normal)) * distance.sign()[..., None]


def at_slot(
    values: Float[Tensor, "batch hypotheses slots 2"], slot: Int[Tensor, "batch hypotheses 1"]
) -> Float[Tensor, "batch hypotheses 1 2"]:
    """Return the vector of one slot of each experiment and hypothesis."""
    return values.gather(2, slot[..., None].expand(-1, -1, -1, 2))


def describe(
    towers: TowerHypotheses,
) -> tuple[Float[Tensor, "batch hypotheses slots features"], Float[Tensor, "batch hypotheses 2 2"]]:
    """Return features of every block in the frame of its tower's weakest joint, and the unit vectors x and y of this frame.

    Lengths are in edges of a block. Features are five vectors: the block's place from the face of the weakest joint, where the block's
    load bears from both faces of its joint, where that of the weakest joint bears from its face, and the tilt; then the height above
    the ground and above the weakest joint's block, two features of how fast the weakest joint's load topples, the logarithms of the
    load's and the block's mass, the yaw in the frame if it is known, and five margins, each also squashed: the joint's, the two
    smallest of the tower, and the smallest above and below.
    """
    joints, z = find_joints(towers), towers.position[..., 2]
    margin = joints.margin
    weakest = margin.argmin(dim=2, keepdim=True)
    x_axis, face, weakest_point = (at_slot(each, weakest) for each in (joints.normal, joints.face, joints.load_point))
    axes = torch.cat([x_axis, rotate_quarter(x_axis)], dim=2)
    xy = towers.position[:, None, :, :2]
    vectors = [
        xy - face,
        joints.load_point - xy,
        joints.load_point - joints.support,
        weakest_point - face,
        towers.tilt[..., None, :] / NEAR,
    ]
    expanded = torch.stack([each.expand_as(joints.load_point) for each in vectors])
    in_frame = torch.einsum("vbhkx,bhax->bhkva", expanded, axes).flatten(3)

    smallest, second = (
        each[..., None].expand_as(margin) for each in margin.topk(2, largest=False).values.unbind(dim=2)
    )
    next_to = [
        torch.where(joint[:, None], margin[:, :, None], MAX_MARGIN).amin(dim=3)
        for joint in (joints.above, joints.below)
    ]
    margins = [margin, smallest, second, *next_to]

    height = z[:, None] - z[:, None].expand_as(margin).gather(2, weakest)
    # the load of the weakest joint topples about an edge; its angular acceleration is -smallest · rate, in g per edge
    load = towers.mass * (height > -0.5) * towers.presence[:, None]
    ahead = in_frame[..., 0]  # of the centre of the face, towards the edge
    inertia = load * ((ahead - 0.5).square() + (height + 0.5).square() + 1 / 6)
    rate = load.sum(dim=2, keepdim=True) / inertia.sum(dim=2, keepdim=True).clamp(min=EPSILON)
    scalars = [z[:, None], height, rate, -smallest * rate / NEAR, joints.load_mass.log(), towers.mass.log()]
    if towers.yaw is not None:
        turned = 4 * (towers.yaw[:, None] - torch.atan2(x_axis[..., 1], x_axis[..., 0]))
        scalars += [turned.cos(), turned.sin()]
    scalars += [*margins, *(torch.tanh(each / NEAR) for each in margins)]
    features = torch.cat([in_frame, torch.stack([each.expand_as(margin) for each in scalars], dim=3)], dim=3)
    return features.clamp(*LIMITS), axes


class Hypotheses(nn.Module):
    """Mixture of predictions under hypotheses of masses and gravity. Its cost doubles with every block.

    Args:
        hidden_dim: Width of all layers.
        num_frames: T, frames of D with the first.
        block_size: Edge of a block, metres; None where objects are no blocks.
        pose: Whether the model sees the yaw of the blocks.

    Raises:
        CophyError: An argument is out of its range, or objects are no blocks.
    """

    def __init__(self, *, hidden_dim: int, num_frames: int, block_size: float | None, pose: bool) -> None:
        super().__init__()
        if block_size is None:
            raise CophyError("model=hypotheses predicts towers: it needs scenario=blocktower")
        check_at_least(1, hidden_dim=hidden_dim)
        check_at_least(2, num_frames=num_frames)
        check_positive(block_size=block_size)
        self.block_size, self.pose = block_size, pose
        self.log_ratio = nn.Parameter(torch.tensor(INITIAL_LOG_RATIO))
        self.tilt = nn.Parameter(torch.tensor(INITIAL_TILT))
        self.block = nn.Sequential(mlp(NUM_FEATURES + 2 * pose, hidden_dim, 2), nn.ReLU())  # f
        self.tower = mlp(2 * hidden_dim, hidden_dim, 2)  # g
        self.outcome = nn.Linear(hidden_dim, 4 * (num_frames - 1))  # W: motion, and the logit of being stable
        self.evidence = mlp(hidden_dim + 6 * (num_frames - 1), hidden_dim, 3, output_dim=1)  # s

    def forward(self, inputs: Inputs) -> Prediction:
        """Predict D at the frames of AB after the first.

        Raises:
            ValueError: The pose is not among the inputs, but the model sees it.
        """
        packed, slots = pack(inputs)
        return unpack(self._predict(packed), slots, inputs.presence.shape[1])

    def _predict(self, inputs: Inputs) -> Prediction:
        log_weight, (position, logit) = self.weigh(inputs), self.outcomes(inputs)
        mean = torch.einsum("bh,bhtkx->btkx", log_weight.exp(), position)
        log_stable, log_moves = (
            (log_weight[..., None, None] + logsigmoid(each)).logsumexp(dim=1) for each in (logit, -logit)
        )
        return Prediction(mean, stable_logit=log_stable - log_moves)

    def combinations(self, slots: int) -> tuple[Float[Tensor, "hypotheses {slots}"], Float[Tensor, "hypotheses 2"]]:
        """Return masses, light times heavy is 1, and tilts of all hypotheses."""
        signs = torch.tensor(list(product(*[(-1.0, 1.0)] * slots, *[(-1.0, 0.0, 1.0)] * 2))).to(self.tilt)
        return (signs[:, :slots] * self.log_ratio / 2).exp(), signs[:, slots:] * self.tilt

    def weigh(self, inputs: Inputs) -> Float[Tensor, "batch hypotheses"]:
        """Return the logarithm of the weight of each hypothesis, in the order of `combinations`."""
        ab, seen = inputs.observed, inputs.observed_presence
        encoded, outcome, axes = self._encode(ab[:, 0], seen, inputs)
        motion = (ab - ab[:, :1])[:, 1:] / self.block_size
        xy = torch.einsum("btkx,bhax->bhkta", motion[..., :2], axes)
        z = motion[..., 2].transpose(1, 2)[:, None, ..., None].expand(*xy.shape[:-1], 1)
        shown = torch.cat([xy, z], dim=-1)
        evidence = [torch.asinh(each / SMALL).flatten(3) / 3 for each in (shown, shown - outcome[..., :3])]
        score = self.evidence(torch.cat([encoded, *evidence], dim=-1)).squeeze(-1)
        return (score * seen[:, None]).sum(dim=2).log_softmax(dim=1)

    def outcomes(
        self, inputs: Inputs
    ) -> tuple[Float[Tensor, "batch hypotheses steps slots 3"], Float[Tensor, "batch hypotheses steps slots"]]:
        """Return positions in D under each hypothesis, metres, and logits of being stable."""
        _, outcome, axes = self._encode(inputs.initial, inputs.presence, inputs)
        xy, z = torch.einsum("bhkta,bhax->bhtkx", outcome[..., :2], axes), outcome[..., 2:3].transpose(2, 3)
        position = inputs.initial[:, None, None] + self.block_size * torch.cat([xy, z], dim=-1)
        return position, outcome[..., 3].transpose(2, 3)

    def _encode(
        self, position: Float[Tensor, "batch slots 3"], presence: Bool[Tensor, "batch slots"], inputs: Inputs
    ) -> tuple[
        Float[Tensor, "batch hypotheses slots hidden"],
        Float[Tensor, "batch hypotheses slots steps 4"],
        Float[Tensor, "batch hypotheses 2 2"],
    ]:
        """Return features of blocks, their motion in edges and logits of being stable, and the axes of the frame."""
        yaw = None
        if self.pose:
            if inputs.pose is None:
                raise ValueError("pose is not among the inputs: a model needs pose: true for it")
            yaw = yaw_of(inputs.pose)
        towers = TowerHypotheses(position / self.block_size, presence, yaw, *self.combinations(presence.shape[1]))
        features, axes = describe(towers)
        blocks, present = self.block(features), presence[:, None, :, None]
        mean = (blocks * present).sum(dim=2, keepdim=True) / present.sum(dim=2, keepdim=True).clamp(min=1)
        encoded = blocks + self.tower(torch.cat([blocks, mean.expand_as(blocks)], dim=-1))
        return encoded, self.outcome(encoded).unflatten(-1, (-1, 4)), axes
