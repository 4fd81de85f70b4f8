"""Contacts of objects: which would touch within a step, at which moment and along which normal.

Frames are 0.2 s apart, so two objects that collide between two frames are apart in both. Both are extrapolated along straight lines
to the moment of contact: momentum passes along the normal of that moment, not along the line between the centres in a frame.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cophy.models.layers import mirrored, others
from cophy.types import POSE_ANGLES

CONTACT_DIM = 5  # features of a contact
OFFSET_DIM = 4  # features of `offsets`
EPSILON = 1e-8  # m²: keeps the slope of square roots finite
IMPULSE_LOGIT_OFFSET = 2.0  # the shares of the largest impulse are σ(-2) = 12 % at the start of training
ITERATIONS = 4  # ours: after them, a disc that meets a square is within millimetres of it
MIN_SLOPE = 0.1  # ours: of the distance along the way; what grazes more moves on in shorter steps
HALF_EDGE_M = 0.5  # of a lying cylinder, which is 1 m long and wide
MAX_GAP_M = 0.02  # ours: at the moment of contact, more is a miss


Pairs = Float[Tensor, "batch others slots 3"]


def dot(first: Float[Tensor, "*any dims"], second: Float[Tensor, "*any dims"]) -> Float[Tensor, "*any 1"]:
    """Return the scalar product."""
    return (first * second).sum(dim=-1, keepdim=True)


def length(vectors: Float[Tensor, "*any dims"]) -> Float[Tensor, "*any 1"]:
    """Return the length, which is never quite zero, so that it can be a divisor."""
    return dot(vectors, vectors).add(EPSILON).sqrt()


def offsets(vectors: Float[Tensor, "batch slots 3"]) -> Float[Tensor, "batch others slots 4"]:
    """Return the difference from each receiver to each of the others, and its length."""
    difference = others(vectors) - vectors[:, None]
    return torch.cat([difference, length(difference)], dim=-1)


@dataclass
class Contact:
    """The next contact of each object with each of the others (in the order of `others`).

    Attributes:
        moment: Share of the step until the two touch or are nearest: 0 if they separate or overlap already, 1 if they
            still approach after the step.
        normal: Unit vector from the object to the other at that moment.
        approach: Velocity of the other relative to the object along the normal, metres per step; negative if they
            approach each other.
        slip: Remainder of the relative velocity, metres per step.
        gap: Distance between the surfaces at that moment, metres.
        touches: 1 if the two touch within the step, else 0.
    """

    moment: Float[Tensor, "batch others slots 1"]
    normal: Float[Tensor, "batch others slots 3"]
    approach: Float[Tensor, "batch others slots 1"]
    slip: Float[Tensor, "batch others slots 3"]
    gap: Float[Tensor, "batch others slots 1"]
    touches: Float[Tensor, "batch others slots 1"]

    def features(self) -> Float[Tensor, "batch others slots 5"]:
        """Return the features that do not depend on direction."""
        return torch.cat([self.moment, self.gap, self.approach, length(self.slip), self.touches], dim=-1)

    def impulse(self, logits: Float[Tensor, "batch others slots 3"]) -> Float[Tensor, "batch others slots 3"]:
        """Return the change of the object's motion by the other, metres per step.

        A pair conserves momentum for masses that fit its shares, which sum to 1, and gains no energy: it reverses the
        approach and removes the slip at most.

        Args:
            logits: Of how far approach and slip are reversed, summed over both objects, and of the object's share in these
                changes, of which the other's is subtracted: the lighter object has the larger share.
        """
        other = mirrored(logits)
        reversed_parts = torch.sigmoid((logits + other)[..., :2] - IMPULSE_LOGIT_OFFSET)
        approach, slip = (reversed_parts * torch.sigmoid((logits - other)[..., 2:])).chunk(2, dim=-1)
        return 2 * approach * self.approach * self.normal + slip * self.slip

    def along(self, change: Float[Tensor, "batch slots 3"]) -> Float[Tensor, "batch others slots 4"]:
        """Project changes of motion of the object and of the other on the normal and on the direction of slip."""
        tangent = self.slip / length(self.slip)
        pair = (change[:, None].expand_as(self.normal), others(change))
        return torch.cat([dot(each, axis) for axis in (self.normal, tangent) for each in pair], dim=-1)


class Contacts(nn.Module):
    """Predicts contacts. Seen from above, objects are discs of one learned size, and lying cylinders, if poses are known, are squares.

    A lying cylinder is as long as its diameter. Its direction is that at t = 0, before it is hit.
    """

    def __init__(self) -> None:
        """Start with a distance of 1 m between the centres at contact."""
        super().__init__()
        self.reach = nn.Parameter(torch.tensor(1.0))

    def forward(
        self,
        position: Float[Tensor, "batch slots 3"],
        motion: Float[Tensor, "batch slots 3"],
        pose: Float[Tensor, "batch slots 7"] | None = None,
    ) -> Contact:
        """Predict the contacts of one step of constant velocity.

        Args:
            position: Centres, metres.
            motion: Displacement in the step, metres.
            pose: Orientation of each object, see `cophy.types.POSE`; None for discs alone.
        """
        offset, velocity = others(position) - position[:, None], others(motion) - motion[:, None]
        moment, normal, gap, touches = self._of_discs(offset, velocity)
        if pose is not None:
            lies, turned = lying_cylinders(pose)
            own, other = lies[:, None].expand_as(others(lies)), others(lies)
            axis = torch.where(own, turned[:, None], others(turned))
            sign = torch.where(own, 1.0, -1.0)  # from the square to the disc
            square = self._of_disc_and_square(sign * offset, sign * velocity, axis)
            one_lies = own ^ other
            moment, gap = torch.where(one_lies, square[0], moment), torch.where(one_lies, square[2], gap)
            normal, touches = torch.where(one_lies, sign * square[1], normal), torch.where(one_lies, square[3], touches)
        approach = dot(velocity, normal)
        return Contact(moment, normal, approach, velocity - approach * normal, gap, touches.to(position.dtype))

    def _of_discs(self, offset: Pairs, velocity: Pairs) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return moment, normal, gap and whether two discs touch, as in `Contact`."""
        # |offset + s · velocity|² = reach² is a quadratic equation for the moment s
        a, b, c = dot(velocity, velocity) + 1e-6, dot(offset, velocity), dot(offset, offset) - self.reach**2
        root = b.square() - a * c
        meets = (root > 0) & (b < 0)
        moment = torch.where(meets, (-b - root.clamp(min=EPSILON).sqrt()) / a, -b / a).clamp(0, 1)
        offset_at_contact = offset + moment * velocity
        distance = length(offset_at_contact)
        return moment, offset_at_contact / distance, distance - self.reach, meets & (moment < 1)

    def _of_disc_and_square(
        self, offset: Pairs, velocity: Pairs, axis: Float[Tensor, "batch others slots 2"]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return moment, normal, gap and whether they touch, with offset and velocity of the disc from a square with this axis."""
        cos, sin = axis.chunk(2, dim=-1)
        rotation = torch.stack([axis, torch.cat([-sin, cos], dim=-1)], dim=-2)  # to the frame of the square
        start, way = (torch.einsum("...ij,...j->...i", rotation, each[..., :2]) for each in (offset, velocity))
        speed, radius = (dot(way, way) + 1e-6).sqrt(), self.reach / 2
        moment = torch.zeros_like(speed)
        for _ in range(
            ITERATIONS
        ):  # Newton's: the distance is a convex function of the moment, so no step goes too far
            outside = from_square(start + moment * way)
            distance = length(outside)
            slope = dot(outside / distance, way).clamp(max=-MIN_SLOPE * speed)
            moment = moment - (distance - radius) / slope
        nearest = -dot(start, way) / speed.square()
        moment = torch.minimum(moment, nearest).clamp(0, 1)
        outside = from_square(start + moment * way)
        distance = length(outside)
        normal = torch.einsum("...ji,...j->...i", rotation, outside / distance)
        normal = torch.cat([normal, torch.zeros_like(distance)], dim=-1)
        meets = (distance - radius < MAX_GAP_M) & (dot(normal, velocity) < 0)
        return moment, normal, distance - radius, meets & (moment < 1)


def from_square(point: Float[Tensor, "*any 2"]) -> Float[Tensor, "*any 2"]:
    """Return the vector from the nearest point of a square, whose sides of 1 m are along the axes, to a point."""
    return point - point.clamp(-HALF_EDGE_M, HALF_EDGE_M)


def lying_cylinders(
    pose: Float[Tensor, "batch slots 7"],
) -> tuple[Bool[Tensor, "batch slots 1"], Float[Tensor, "batch slots 2"]]:
    """Return which objects are lying cylinders, and the direction of their axes, (1, 0) for others."""
    # r² cos 2ψ and r² sin 2ψ, where r is 1 for a lying cylinder and 0 for a standing one
    double = pose[..., POSE_ANGLES[2]]
    angle = torch.atan2(double[..., 1], double[..., 0]) / 2
    return dot(double, double) > 0.25, torch.stack([angle.cos(), angle.sin()], dim=-1)
