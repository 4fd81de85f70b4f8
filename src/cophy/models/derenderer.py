"""Image -> positions and presence of every slot (paper, appendix, Neural de-rendering)."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn


class Derendered(NamedTuple):
    """What is seen in a frame. position: (B, K, 3) metres; presence_logit: (B, K), positive means present."""

    position: Tensor
    presence_logit: Tensor


class Derenderer(nn.Module):
    """Three double convolutions with max-pooling between, then a head per slot on its own share of the channels.

    slots: names of the K slots. resolution: edge of the images in pixels, a multiple of 4 (paper: 224). width: channels of the first
    double convolution (paper: 64), of which the second has twice and the third four times as many, rounded up to a
    multiple of K. Presence is ours: the paper's removals need it. Positions leave the network scaled by `scale_`.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, *, slots: Sequence[str], resolution: int, width: int) -> None:
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
        self.heads = _double_convolution(channels, num_slots, groups=num_slots)
        pixels = (resolution // 4) ** 2
        self.regression = nn.Parameter(torch.randn(num_slots, pixels, 4) / pixels**0.5)
        self.bias = nn.Parameter(torch.zeros(num_slots, 4))
        self.register_buffer("mean", torch.zeros(3))
        self.register_buffer("deviation", torch.ones(3))

    def scale_(self, mean: Tensor, deviation: Tensor) -> None:
        """Mean and standard deviation (3,) of the positions, in metres, over the training frames."""
        self.mean.copy_(mean)
        self.deviation.copy_(deviation)

    def forward(self, image: Tensor) -> Derendered:
        """(B, 3, R, R) in [0, 1] -> positions and presence."""
        centred = (image - 0.5).contiguous(
            memory_format=torch.channels_last
        )  # on a CPU, half to two thirds of the time
        maps = self.heads(self.features(centred)).flatten(start_dim=2)
        found = torch.einsum("bkp,kpf->bkf", maps, self.regression) + self.bias
        return Derendered(self.mean + self.deviation * found[..., :3], found[..., 3])


def _double_convolution(inputs: int, outputs: int, groups: int = 1) -> nn.Sequential:
    """Convolution, batch normalisation and ReLU, twice."""
    layers: list[nn.Module] = []
    for channels in (inputs, outputs):
        convolution = nn.Conv2d(channels, outputs, kernel_size=3, padding=1, groups=groups, bias=False)
        layers += [convolution, nn.BatchNorm2d(outputs), nn.ReLU()]
    return nn.Sequential(*layers)
