"""Linear layers as values, so that two in a row can become one."""

from typing import NamedTuple

from torch import Tensor, nn
from torch.nn.functional import linear


class Affine(NamedTuple):
    """x -> W x + b. weight: (output, input); bias: (output)."""

    weight: Tensor
    bias: Tensor

    def __call__(self, x: Tensor) -> Tensor:
        """(..., input) -> (..., output)."""
        return linear(x, self.weight, self.bias)

    def after(self, first: nn.Linear) -> "Affine":
        """The one layer that does what `first` and then this one do."""
        return Affine(self.weight @ first.weight, self(first.bias))


def affine(layer: nn.Linear) -> Affine:
    """The weights of a layer."""
    return Affine(layer.weight, layer.bias)
