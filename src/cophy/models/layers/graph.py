"""Which objects hear which, and with what weight; all pairs of objects at once."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor


def others(objects: Shaped[Tensor, "batch slots *features"]) -> Shaped[Tensor, "batch others slots *features"]:
    """What the other slots hold, for each slot: K - 1 copies of the slots, rotated by 1, 2, … K - 1.

    `others(x)[:, j, k]` is `x[:, (k - 1 - j) % K]` for j = 0 … K - 2. So every slot meets every other once and itself
    never. Empty slots are met too; a `Graph` gives them the weight 0.
    """
    return torch.stack([objects.roll(shift, dims=1) for shift in range(1, objects.shape[1])], dim=1)


@dataclass
class Graph:
    """Who is there, and with what weight objects hear each other.

    Attributes:
        present: 1 for a slot that holds an object, else 0.
        pair_weights: Weight with which a slot hears each of the others (in the order of `others`); 0 for not at all.
        mean_weights: Weight of each slot in a mean over all objects.
    """

    present: Float[Tensor, "batch slots 1"]
    pair_weights: Float[Tensor, "batch others slots 1"]
    mean_weights: Float[Tensor, "batch slots 1"]

    def sum_over_senders(
        self, messages: Float[Tensor, "batch others slots hidden"]
    ) -> Float[Tensor, "batch slots hidden"]:
        """What each slot hears: the weighted sum of its messages; zero for an object that hears nobody."""
        return (self.pair_weights * messages).sum(dim=1)

    def mean_over_objects(self, objects: Float[Tensor, "batch slots hidden"]) -> Float[Tensor, "batch slots hidden"]:
        """The mean over all present objects, the same in every slot."""
        return (self.mean_weights * objects).sum(dim=1, keepdim=True).expand_as(objects)


def hear_mean_of_others(presence: Bool[Tensor, "batch slots"], dtype: torch.dtype) -> Graph:
    """The graph of Eq. 1: every present object hears the mean over all others that are present."""
    heard = (others(presence) & presence[:, None]).to(dtype)[..., None]
    return _graph(presence, heard / heard.sum(dim=1, keepdim=True).clamp(min=1))


def hear_sum_of_near(
    radius: float | None, position: Float[Tensor, "batch slots 3"], presence: Bool[Tensor, "batch slots"]
) -> Graph:
    """The graph of the baselines: every present object hears the sum over all others that are near.

    Args:
        radius: Metres between two centres; None for all others, however far.
        position: Centres, metres.
        presence: Which slots hold an object.
    """
    heard = others(presence) & presence[:, None]
    if radius is not None:
        heard = heard & ((others(position) - position[:, None]).square().sum(dim=-1) < radius**2)
    return _graph(presence, heard.to(position.dtype)[..., None])


def _graph(presence: Bool[Tensor, "batch slots"], pair_weights: Float[Tensor, "batch others slots 1"]) -> Graph:
    present = presence.to(pair_weights.dtype)[..., None]
    return Graph(present, pair_weights, present / present.sum(dim=1, keepdim=True).clamp(min=1))
