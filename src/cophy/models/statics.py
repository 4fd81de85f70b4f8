"""Statics with learned masses: how a tower of blocks would rest under hypotheses that are read off AB. It is not in the paper.

A tower stands where, at every joint, the centre of mass of all that rests on it projects, along the tilted gravity, inside the
contact (`cophy.scenario.statics`). A network needs many experiments to learn this from positions. Here it is computed, with masses and
tilts that AB has to tell: several hypotheses, so that the features of one can say that masses matter, and those of another that gravity
does. All depends on which blocks lie above and below, not on how many there are.

Contacts also depend on the yaw of the blocks, which positions do not show. With true masses and gravity, the smallest margin tells
whether C stands for 76 % of towers of three if faces count as discs, and for all of them if the yaw is known.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cophy.types import POSE_ANGLES

EPSILON = 1e-8  # m²: keeps the slope of square roots finite
MAX_LOG_MASS = 2.0  # ours: ratios of masses up to e⁴ = 55; those of towers are 1 and 10
MAX_TILT = 0.3  # ours: horizontal over vertical gravity; that of towers is at most 0.14


class LearnedStatics(nn.Module):
    """Computes where the load of each joint bears, under hypotheses of masses and tilt."""

    def __init__(self, encoded_dim: int, num_hypotheses: int, block_size: float) -> None:
        """Build the layers that read the hypotheses.

        Args:
            encoded_dim: Features of AB per block.
            num_hypotheses: Sets of masses and tilt.
            block_size: Edge of a block, metres.
        """
        super().__init__()
        self.num_hypotheses, self.block_size = num_hypotheses, block_size
        self.to_log_mass = nn.Linear(encoded_dim, num_hypotheses)
        self.to_tilt = nn.Linear(encoded_dim, 2 * num_hypotheses)

    @property
    def width(self) -> int:
        """Number of features of a block."""
        return 7 * self.num_hypotheses

    def hypotheses(
        self, encoded: Float[Tensor, "batch slots encoded"], seen: Bool[Tensor, "batch slots"]
    ) -> tuple[Float[Tensor, "batch slots hypotheses"], Float[Tensor, "batch hypotheses 2"]]:
        """Return the mass of each block, without a unit, and the tilt (horizontal over vertical gravity), a mean over blocks.

        Args:
            encoded: Features of AB; zero for a block that AB does not show.
            seen: Which blocks AB shows.
        """
        mass = (MAX_LOG_MASS * torch.tanh(self.to_log_mass(encoded))).exp()
        weight = seen[..., None].to(encoded.dtype)
        tilt = (self.to_tilt(encoded) * weight).sum(dim=1) / weight.sum(dim=1).clamp(min=1)
        return mass, MAX_TILT * torch.tanh(tilt).view(-1, self.num_hypotheses, 2)

    def forward(
        self,
        position: Float[Tensor, "batch slots 3"],
        presence: Bool[Tensor, "batch slots"],
        mass: Float[Tensor, "batch slots hypotheses"],
        tilt: Float[Tensor, "batch hypotheses 2"],
        pose: Float[Tensor, "batch slots 7"] | None = None,
    ) -> Float[Tensor, "batch slots features"]:
        """Return for the joint below each block, and for each hypothesis, in metres.

        - the point where the load bears, relative to the block and to the one below it (x and y each; zero on the ground);
        - the joint's margin: how far this point is from the edge of both faces; below zero, the joint fails;
        - the smallest margin of all joints of the tower, and of those above.

        Args:
            position: Centres, metres.
            presence: Which slots hold a block.
            mass, tilt: See `hypotheses`.
            pose: Tells the yaw of each block (`cophy.types.POSE`); without it, faces count as discs.
        """
        xy, z = position[..., :2], position[..., 2]
        lower = z[:, None] < z[:, :, None] - self.block_size / 2  # (batch, block, other): the other is lower
        load = ~lower & presence[:, None]  # of the joint below a block: the block and all that is not lower
        weight = load[..., None] * mass[:, None]
        weight = weight / weight.sum(dim=2, keepdim=True).clamp(min=EPSILON)
        centre = torch.einsum("bkjh,bjx->bkhx", weight, xy)
        height = torch.einsum("bkjh,bj->bkh", weight, z) - z[..., None] + self.block_size / 2
        bears = centre + tilt[:, None] * height[..., None]
        below = lower & presence[:, None]
        support = torch.where(below, z[:, None], -torch.inf).argmax(dim=2)  # the highest of the lower blocks
        support_xy = xy.gather(1, support[..., None].expand_as(xy))
        from_block = bears - xy[:, :, None]
        from_support = (bears - support_xy[:, :, None]) * below.any(dim=2)[..., None, None]
        yaws: list[Tensor | None] = [None, None]
        if pose is not None:
            cos, sin = pose[..., POSE_ANGLES[4]].unbind(dim=-1)
            yaw = torch.atan2(sin, cos) / 4
            yaws = [yaw, yaw.gather(1, support)]
        distance = torch.maximum(*map(from_centre, (from_block, from_support), yaws))
        margin = torch.where(presence[..., None], self.block_size / 2 - distance, self.block_size)
        lowest = margin.amin(dim=1, keepdim=True).expand_as(margin)
        above = torch.where(load[..., None], margin[:, None], self.block_size).amin(dim=2)
        features = [from_block.flatten(2), from_support.flatten(2), margin, lowest, above]
        return torch.cat(features, dim=-1) * presence[..., None]


def from_centre(
    vector: Float[Tensor, "batch slots hypotheses 2"], yaw: Float[Tensor, "batch slots"] | None
) -> Float[Tensor, "batch slots hypotheses"]:
    """Return the distance of a point from the centre of a face: half an edge on its edges. Without a yaw, the face is a disc."""
    if yaw is None:
        return vector.square().sum(dim=-1).add(EPSILON).sqrt()
    x, y = vector.unbind(dim=-1)
    cos, sin = yaw.cos()[..., None], yaw.sin()[..., None]
    return torch.maximum((cos * x + sin * y).abs(), (cos * y - sin * x).abs())
