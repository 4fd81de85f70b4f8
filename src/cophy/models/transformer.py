"""A transformer over the objects and frames of AB, which predicts all of D at once. It is not in the paper.

There is a token per object and frame t: its position and motion in AB at t, and where it is in C. Attention is factorised, as in
OCVP (Villar-Corrales et al., 2023): layers over the objects of a frame alternate with layers over the frames of an object. Only
time is encoded by its place, so objects stay exchangeable. The token of frame t becomes D_t - C.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from cophy.errors import CophyError
from cophy.models.layers import Appearance, check_at_least, mlp, pack, unpack
from cophy.types import Inputs, Prediction

TOKEN_DIM = 14  # position and motion in AB, C, C - A (3 each), presence in AB and in C
WIDENING = 2  # ours: width of a layer's MLP over that of a token; 4 is usual, and slower
RATE_RANGE = 100.0  # ours: the fastest rate of the encoding of time ÷ the slowest; the longest period is many sequences


class Transformer(nn.Module):
    """Maps AB and C to D, with any number of objects in any order.

    Args:
        hidden_dim: Width of a token; a multiple of twice the number of heads.
        num_layers: Layers over objects, and as many over frames.
        num_heads: Heads of attention.
        object_type: Whether the model sees the type of each object.
        pose: Whether the model sees the orientation of each object at t = 0.

    Raises:
        CophyError: An argument is out of its range.
    """

    def __init__(
        self, *, hidden_dim: int, num_layers: int, num_heads: int, object_type: bool = False, pose: bool = False
    ) -> None:
        super().__init__()
        check_at_least(1, num_layers=num_layers, num_heads=num_heads)
        if hidden_dim < 1 or hidden_dim % (2 * num_heads):
            raise CophyError(
                f"model.hidden_dim={hidden_dim} must be a multiple of {2 * num_heads}, twice model.num_heads"
            )
        self.appearance = Appearance(object_type, pose)
        self.embed = mlp(TOKEN_DIM + self.appearance.width, hidden_dim, 2)

        def layers() -> nn.ModuleList:
            return nn.ModuleList(
                nn.TransformerEncoderLayer(
                    hidden_dim, num_heads, WIDENING * hidden_dim, dropout=0.0, batch_first=True, norm_first=True
                )
                for _ in range(num_layers)
            )

        self.over_objects, self.over_time = layers(), layers()
        self.norm = nn.LayerNorm(hidden_dim)
        self.to_displacement = nn.Linear(hidden_dim, 3)
        self.to_stable_logit = nn.Linear(hidden_dim, 1)

    def forward(self, inputs: Inputs) -> Prediction:
        """Predict D, one step per frame of AB after the first."""
        packed, slots = pack(inputs)
        return unpack(self._predict(packed), slots, inputs.presence.shape[1])

    def _predict(self, inputs: Inputs) -> Prediction:
        tokens = self.embed(self.appearance.concatenate_to(tokens_of(inputs), inputs))  # batch time slots hidden
        batch, time, slots, hidden = tokens.shape
        tokens = tokens + time_encoding(time, hidden, tokens.device)[:, None]
        absent = without_empty_rows(~(inputs.observed_presence | inputs.presence)).repeat_interleave(time, dim=0)
        for over_objects, over_time in zip(self.over_objects, self.over_time, strict=True):
            tokens = over_objects(tokens.flatten(0, 1), src_key_padding_mask=absent).view(batch, time, slots, hidden)
            tokens = over_time(tokens.transpose(1, 2).flatten(0, 1)).view(batch, slots, time, hidden).transpose(1, 2)
        final = self.norm(tokens[:, 1:])
        position = inputs.initial[:, None] + self.to_displacement(final)
        return Prediction(position, self.to_stable_logit(final).squeeze(-1))


def tokens_of(inputs: Inputs) -> Float[Tensor, "batch time slots 14"]:
    """Return what the model knows of each object at each frame of AB; zero where an object is absent."""
    seen, present = inputs.observed_presence, inputs.presence
    observed = inputs.observed * seen[:, None, :, None]
    motion = torch.cat([observed[:, 1:] - observed[:, :-1], torch.zeros_like(observed[:, :1])], dim=1)
    initial = inputs.initial * present[..., None]
    shift = (initial - observed[:, 0]) * (seen & present)[..., None]
    constant = torch.cat([initial, shift, torch.stack([seen, present], dim=-1).to(initial.dtype)], dim=-1)
    repeated = constant[:, None].expand(-1, observed.shape[1], -1, -1)
    return torch.cat([observed, motion, repeated], dim=-1)


def time_encoding(length: int, width: int, device: torch.device) -> Float[Tensor, "length width"]:
    """Return sines and cosines of the frame's index, as in Vaswani et al. (2017)."""
    rates = torch.exp(-math.log(RATE_RANGE) * torch.arange(width // 2, device=device) / (width // 2))
    phases = torch.arange(length, device=device)[:, None] * rates
    return torch.cat([phases.sin(), phases.cos()], dim=-1)


def without_empty_rows(absent: Bool[Tensor, "batch slots"]) -> Bool[Tensor, "batch slots"]:
    """Return the mask, but False in a row of nothing but empty slots: attention to nothing would be NaN."""
    return absent & ~absent.all(dim=1, keepdim=True)
