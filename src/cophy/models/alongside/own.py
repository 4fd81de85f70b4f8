"""What an object knows of itself in one frame."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from cophy.models.appearance import Appearance
from cophy.types import Inputs

HIGH = 2.0  # metres; ours: of blocks above it, one in 112,938 is near the ground 0.2 s later (3,000 towers)


@dataclass(frozen=True)
class Own:
    """Height up to `HIGH`, motion, how it looks, and where it is between walls if there are any.

    Attributes:
        arena_half_width: From the middle to each of four walls, metres; None where there are none. Without walls an object
            does not know where on the ground it is, only where it is to others.
        appearance: What is told of how objects look.
    """

    arena_half_width: float | None
    appearance: Appearance

    @property
    def width(self) -> int:
        """Features of an object."""
        return 4 + 4 * (self.arena_half_width is not None) + self.appearance.width

    def of(
        self,
        position: Float[Tensor, "batch slots 3"],
        motion: Float[Tensor, "batch slots 3"],
        reach: Float[Tensor, ""],
        inputs: Inputs,
    ) -> Float[Tensor, "batch slots own"]:
        """Features of all objects.

        Args:
            position: Centres, metres.
            motion: What each moved in the last step, taken for the next one too, metres.
            reach: Metres between two centres as they touch, twice what is between a centre and a wall.
            inputs: What else is known.
        """
        own = [position[..., 2:].clamp(max=HIGH), motion]
        if self.arena_half_width is not None:
            following = (position + motion)[..., :2]
            beyond = (following.abs() - (self.arena_half_width - reach / 2)).relu() * following.sign()
            own += [position[..., :2] / self.arena_half_width, beyond]
        return self.appearance.beside(torch.cat(own, dim=-1), inputs)
