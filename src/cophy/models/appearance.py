"""What a model may be told of how objects look at t = 0, beside where they are: their types and their poses."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from cophy.types import OBJECT_TYPES, POSE, Inputs


@dataclass(frozen=True)
class Appearance:
    """What of it a model's configuration declares. The paper's models see positions alone.

    Attributes:
        object_type: Whether the model sees which objects are boxes, spheres and cylinders.
        pose: Whether it sees how they are turned.
    """

    object_type: bool
    pose: bool

    @property
    def width(self) -> int:
        """Features of an object."""
        return len(OBJECT_TYPES) * self.object_type + len(POSE) * self.pose

    def beside(
        self, features: Float[Tensor, "batch *time slots any"], inputs: Inputs
    ) -> Float[Tensor, "batch *time slots more"]:
        """Features of the objects, once or in every frame, with the declared ones behind them.

        Raises:
            ValueError: What is declared is not among the inputs.
        """
        if not self.width:
            return features
        named = {"object_type": inputs.object_type, "pose": inputs.pose}
        declared = [self._given(name, tensor) for name, tensor in named.items() if getattr(self, name)]
        behind = torch.cat(declared, dim=-1)
        if features.ndim > behind.ndim:
            behind = behind[:, None].expand(-1, features.shape[1], -1, -1)
        return torch.cat([features, behind], dim=-1)

    @staticmethod
    def _given(name: str, tensor: Tensor | None) -> Tensor:
        if tensor is None:
            raise ValueError(f"{name} is not among the inputs: a model needs {name}: true for it")
        return tensor
