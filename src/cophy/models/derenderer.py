"""Image -> positions and presence of every slot (paper, appendix, Neural de-rendering)."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from cophy.models.layers.mlp import mlp
from cophy.models.options import Readout

LOOKS = 15  # features of an object's looks


class Derendered(NamedTuple):
    """What is seen in a frame. position: (B, K, 3) metres; presence_logit: (B, K), positive means present."""

    position: Tensor
    presence_logit: Tensor


class Derenderer(nn.Module):
    """Three double convolutions with max-pooling between, then a head per slot on its own share of the channels.

    slots: names of the K slots. resolution: edge of the images in pixels, a multiple of 4 (paper: 224). width: channels of
    the first double convolution (paper: 64), of which the second has twice and the third four times as many, rounded up to
    a multiple of K. readout: how the heads find positions, see `options`. Presence is ours: the paper's removals need it.
    Positions leave the network scaled by `scale_`.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, *, slots: Sequence[str], resolution: int, width: int, readout: str) -> None:
        super().__init__()
        num_slots, self.resolution = len(slots), resolution
        channels = -(-4 * width // num_slots) * num_slots
        self.features = nn.Sequential(
            _double_convolution(3, width),
            nn.MaxPool2d(2),
            _double_convolution(width, 2 * width),
            nn.MaxPool2d(2),
            _double_convolution(2 * width, channels),
        )
        kind = AttentionReadout if Readout(readout) is Readout.attention else LinearReadout
        self.heads: nn.Module = kind(channels, num_slots, resolution // 4)
        self.register_buffer("mean", torch.zeros(3))
        self.register_buffer("deviation", torch.ones(3))

    def scale_(self, mean: Tensor, deviation: Tensor) -> None:
        """Mean and standard deviation (3,) of the positions, in metres, over the training frames."""
        self.mean.copy_(mean)
        self.deviation.copy_(deviation)

    def forward(self, image: Tensor) -> Derendered:
        """(B, 3, R, R) in [0, 1] -> positions and presence."""
        # on a CPU channels last saves half to two thirds of the time
        centred = (image - 0.5).contiguous(memory_format=torch.channels_last)
        found = self.heads(self.features(centred))
        return Derendered(self.mean + self.deviation * found[..., :3], found[..., 3])


class LinearReadout(nn.Module):
    """The paper's: a double convolution to one map per slot, then a linear layer on all its places."""

    def __init__(self, channels: int, num_slots: int, edge: int) -> None:
        super().__init__()
        self.maps = _double_convolution(channels, num_slots, groups=num_slots)
        self.weight = nn.Parameter(torch.randn(num_slots, edge**2, 4) / edge)
        self.bias = nn.Parameter(torch.zeros(num_slots, 4))

    def forward(self, features: Tensor) -> Tensor:
        """(B, channels, edge, edge) -> (B, K, 4)."""
        return torch.einsum("bkp,kpf->bkf", self.maps(features).flatten(start_dim=2), self.weight) + self.bias


class AttentionReadout(nn.Module):
    """A head says where in the picture its object is, by a softmax over places, and what it looks like there.

    From both, an MLP finds position and presence; all slots share it, as all are seen by the same camera.
    """

    coordinates: Tensor

    def __init__(self, channels: int, num_slots: int, edge: int) -> None:
        super().__init__()
        self.looks = nn.Sequential(
            *_convolution(channels, channels, groups=num_slots),
            nn.Conv2d(channels, num_slots * (1 + LOOKS), kernel_size=3, padding=1, groups=num_slots, bias=False),
        )
        self.normalise = nn.BatchNorm1d(num_slots, affine=False)
        self.sharpness = nn.Parameter(torch.full((num_slots, 1), 3.0))
        self.geometry = mlp(LOOKS + 2, 64, 3, output_dim=4)
        along = torch.linspace(-5, 5, edge)  # objects then spread by about one
        self.register_buffer("coordinates", torch.cartesian_prod(along, along), persistent=False)

    def forward(self, features: Tensor) -> Tensor:
        """(B, channels, edge, edge) -> (B, K, 4)."""
        looks = self.looks(features).flatten(start_dim=2).unflatten(1, (len(self.sharpness), 1 + LOOKS))
        attention = torch.softmax(self.sharpness * self.normalise(looks[:, :, 0]), dim=-1)
        where = attention @ self.coordinates
        what = torch.einsum("bkp,bkfp->bkf", attention, looks[:, :, 1:])
        return self.geometry(torch.cat([where, what], dim=-1))


def _double_convolution(inputs: int, outputs: int, groups: int = 1) -> nn.Sequential:
    return nn.Sequential(*_convolution(inputs, outputs, groups), *_convolution(outputs, outputs, groups))


def _convolution(inputs: int, outputs: int, groups: int) -> tuple[nn.Module, ...]:
    """Convolution, batch normalisation and ReLU."""
    convolution = nn.Conv2d(inputs, outputs, kernel_size=3, padding=1, groups=groups, bias=False)
    return convolution, nn.BatchNorm2d(outputs), nn.ReLU()
