"""When and how two objects would touch in the next step, and what that does to their motion.

Frames are 0.2 s apart: two balls that meet between them are apart in both. So both are moved on along a straight line to the
moment at which they touch. Momentum passes along the normal of that moment, not along the line between two frames.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.models.layers.graph import others

CONTACT_DIM = 5  # features of a contact
SMALL = 1e-8  # m²: keeps a root's slope finite
CAUTIOUS = 2.0  # impulses start at σ(-2), 12 % of the most that there can be


@dataclass
class Contact:
    """What each object is about to meet in each of the others (in the order of `others`).

    Attributes:
        moment: Share of the step until they touch, or else are nearest: 0 if they part or overlap already, 1 if they come nearer
            still after it.
        normal: Unit vector from the object to the other at that moment.
        approach: Speed of the other along the normal, as seen from the object, metres per step; negative as they approach.
        slip: What is left of that velocity, metres per step.
        gap: Metres that are between them at that moment.
        touches: 1 where they touch within the step, else 0.
    """

    moment: Float[Tensor, "batch others slots 1"]
    normal: Float[Tensor, "batch others slots 3"]
    approach: Float[Tensor, "batch others slots 1"]
    slip: Float[Tensor, "batch others slots 3"]
    gap: Float[Tensor, "batch others slots 1"]
    touches: Float[Tensor, "batch others slots 1"]

    def features(self) -> Float[Tensor, "batch others slots 5"]:
        """What does not change with the direction from which one looks."""
        return torch.cat([self.moment, self.gap, self.approach, length(self.slip), self.touches], dim=-1)

    def impulse(self, share: Float[Tensor, "batch others slots 2"]) -> Float[Tensor, "batch others slots 3"]:
        """How the other changes the object's motion, metres per step.

        Args:
            share: Logits of how much of the approach and of the slip it takes over. Of the approach it is at most twice
                as much, from an elastic body that is far heavier; of the slip it is at most all.
        """
        of_approach, of_slip = torch.sigmoid(share - CAUTIOUS).chunk(2, dim=-1)
        return 2 * of_approach * self.approach * self.normal + of_slip * self.slip

    def along(self, change: Float[Tensor, "batch slots 3"]) -> Float[Tensor, "batch others slots 4"]:
        """How the motion of the object and of the other changes, along the normal and along the slip."""
        across = self.slip / length(self.slip)
        pair = (change[:, None].expand_as(self.normal), others(change))
        return torch.cat([dot(each, axis) for axis in (self.normal, across) for each in pair], dim=-1)


class Contacts(nn.Module):
    """Predicts the contacts of spheres that all have one size, which it learns."""

    def __init__(self) -> None:
        """Begin with centres that are 1 m apart as two objects touch."""
        super().__init__()
        self.reach = nn.Parameter(torch.tensor(1.0))

    def forward(self, position: Float[Tensor, "batch slots 3"], motion: Float[Tensor, "batch slots 3"]) -> Contact:
        """What would happen in one step of constant motion.

        Args:
            position: Centres, metres.
            motion: What each would move in the step, metres.
        """
        apart, moving = others(position) - position[:, None], others(motion) - motion[:, None]
        # |apart + s · moving|² = reach² is a quadratic equation for the moment s
        a, b, c = dot(moving, moving) + 1e-6, dot(apart, moving), dot(apart, apart) - self.reach**2
        root = b.square() - a * c
        meets = (root > 0) & (b < 0)
        moment = torch.where(meets, (-b - root.clamp(min=SMALL).sqrt()) / a, -b / a).clamp(0, 1)
        there = apart + moment * moving
        distance = length(there)
        normal = there / distance
        approach = dot(moving, normal)
        touches = (meets & (moment < 1)).to(position.dtype)
        return Contact(moment, normal, approach, moving - approach * normal, distance - self.reach, touches)


def dot(one: Float[Tensor, "*any 3"], other: Float[Tensor, "*any 3"]) -> Float[Tensor, "*any 1"]:
    """The scalar product."""
    return (one * other).sum(dim=-1, keepdim=True)


def length(vectors: Float[Tensor, "*any 3"]) -> Float[Tensor, "*any 1"]:
    """Never quite zero, so that one can divide by it."""
    return dot(vectors, vectors).add(SMALL).sqrt()
