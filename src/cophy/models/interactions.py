"""How objects hear of each other: what graph convolutions and the MLP that replaces them have in common."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from torch import Tensor

from cophy.models.affine import Affine

Step = Callable[[Tensor], list[Tensor]]  # positions (K·N, 3), slots first, to a readout (K·N, ·) of every module


class Interactions(Protocol):
    """A module of which several, alike, can be applied to the same objects at once."""

    @staticmethod
    def together(parts: Sequence[tuple[Any, Affine]], presence: Tensor, constant: Tensor) -> Step:
        """From position and `constant` of all objects to the features of every module in `parts`, read out linearly.

        presence: (K, N), slots first; constant: (K·N, U), the part of every object's state that stays: its confounders.
        What does not depend on the positions is computed here, once for all steps of a rollout.
        """
