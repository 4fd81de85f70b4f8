"""De-renderer: from an image to the position and presence of every slot (paper, appendix, Neural de-rendering)."""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.errors import CophyError
from cophy.models.layers import check_at_least, mlp, parse_option

NUM_APPEARANCE_FEATURES = 15  # per object, read at its place in the image


class Readout(Enum):
    """How positions are read from the maps: from place and appearance (`attention`), or linearly (the paper's)."""

    attention = "attention"
    linear = "linear"


class Derendered(NamedTuple):
    """Estimates for a batch of images.

    Attributes:
        position: Metres; values in slots without an object are meaningless.
        presence_logit: Positive means present.
    """

    position: Float[Tensor, "batch slots 3"]
    presence_logit: Float[Tensor, "batch slots"]


class Derenderer(nn.Module):
    """Three double convolutions with max-pooling between them, then a head per slot on its own share of the channels.

    Presence is our addition: do-operations remove objects, but the paper's de-renderer predicts no presence.

    Args:
        slots: Names of the K slots.
        resolution: Edge of the images in pixels, a multiple of 4 (paper: 224).
        width: Channels of the first double convolution (paper: 64). The second has twice as many, the third four
            times as many, rounded up to a multiple of K.
        readout: How the heads read positions: a value of `Readout`.

    Raises:
        CophyError: An argument is out of its range.
    """

    mean: Float[Tensor, "3"]
    deviation: Float[Tensor, "3"]

    def __init__(self, *, slots: Sequence[str], resolution: int, width: int, readout: Readout | str) -> None:
        super().__init__()
        check_at_least(1, width=width)
        if resolution < 8 or resolution % 4:
            raise CophyError(f"model.resolution={resolution} must be a multiple of 4 and at least 8")
        if not slots:
            raise CophyError("model.slots is empty: a de-renderer needs at least one slot")
        num_slots, self.resolution = len(slots), resolution
        channels = -(-4 * width // num_slots) * num_slots
        self.features = nn.Sequential(
            _double_convolution(3, width),
            nn.MaxPool2d(2),
            _double_convolution(width, 2 * width),
            nn.MaxPool2d(2),
            _double_convolution(2 * width, channels),
        )
        is_linear = parse_option(Readout, "readout", readout) is Readout.linear
        self.heads: nn.Module = (LinearReadout if is_linear else AttentionReadout)(channels, num_slots, resolution // 4)
        self.register_buffer("mean", torch.zeros(3))
        self.register_buffer("deviation", torch.ones(3))

    def scale_(self, mean: Float[Tensor, "3"], deviation: Float[Tensor, "3"]) -> None:
        """Set the mean and standard deviation of positions over the training frames, metres.

        The heads learn positions in units of this spread.
        """
        self.mean.copy_(mean)
        self.deviation.copy_(deviation)

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> Derendered:
        """Estimate positions and presence from images with values in [0, 1]."""
        # on a CPU, channels last saves half to two thirds of the time
        centred = (image - 0.5).contiguous(memory_format=torch.channels_last)
        output = self.heads(self.features(centred))
        return Derendered(self.mean + self.deviation * output[..., :3], output[..., 3])


class LinearReadout(nn.Module):
    """The paper's readout: a double convolution to one map per slot, then a linear layer on all its pixels."""

    def __init__(self, channels: int, num_slots: int, edge: int) -> None:
        super().__init__()
        self.maps = _double_convolution(channels, num_slots, groups=num_slots)
        self.weight = nn.Parameter(torch.randn(num_slots, edge**2, 4) / edge)
        self.bias = nn.Parameter(torch.zeros(num_slots, 4))

    def forward(self, features: Float[Tensor, "batch channels edge edge"]) -> Float[Tensor, "batch slots 4"]:
        """Return the scaled position and the presence logit of every slot."""
        return torch.einsum("bkp,kpf->bkf", self.maps(features).flatten(start_dim=2), self.weight) + self.bias


class AttentionReadout(nn.Module):
    """Readout by spatial attention: a softmax over the pixels locates the object of a slot and reads its appearance there.

    From both, an MLP estimates position and presence. All slots share it, because all share the camera.
    """

    coordinates: Float[Tensor, "places 2"]

    def __init__(self, channels: int, num_slots: int, edge: int) -> None:
        super().__init__()
        self.maps = nn.Sequential(
            *_convolution(channels, channels, groups=num_slots),
            nn.Conv2d(
                channels,
                num_slots * (1 + NUM_APPEARANCE_FEATURES),
                kernel_size=3,
                padding=1,
                groups=num_slots,
                bias=False,
            ),
        )
        self.normalise = nn.BatchNorm1d(num_slots, affine=False)
        self.sharpness = nn.Parameter(torch.full((num_slots, 1), 3.0))
        self.geometry = mlp(NUM_APPEARANCE_FEATURES + 2, 64, 3, output_dim=4)
        # about unit spread for objects; on the CPU even under torch.device("meta"), where linspace takes seconds
        along = torch.linspace(-5, 5, edge, device="cpu")
        self.register_buffer("coordinates", torch.cartesian_prod(along, along), persistent=False)

    def forward(self, features: Float[Tensor, "batch channels edge edge"]) -> Float[Tensor, "batch slots 4"]:
        """Return the scaled position and the presence logit of every slot."""
        maps = self.maps(features).flatten(start_dim=2).unflatten(1, (len(self.sharpness), 1 + NUM_APPEARANCE_FEATURES))
        attention = torch.softmax(self.sharpness * self.normalise(maps[:, :, 0]), dim=-1)
        place = attention @ self.coordinates
        appearance = torch.einsum("bkp,bkfp->bkf", attention, maps[:, :, 1:])
        return self.geometry(torch.cat([place, appearance], dim=-1))


def _double_convolution(inputs: int, outputs: int, groups: int = 1) -> nn.Sequential:
    return nn.Sequential(*_convolution(inputs, outputs, groups), *_convolution(outputs, outputs, groups))


def _convolution(inputs: int, outputs: int, groups: int) -> tuple[nn.Module, ...]:
    """Return a convolution, batch normalisation and ReLU."""
    convolution = nn.Conv2d(inputs, outputs, kernel_size=3, padding=1, groups=groups, bias=False)
    return convolution, nn.BatchNorm2d(outputs), nn.ReLU()
