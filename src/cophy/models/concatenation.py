"""What replaces the graph convolution in the ablation `mlp` (paper Table 6 left)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from cophy.models.affine import Affine
from cophy.models.interactions import Step
from cophy.models.mlp import mlp


class Concatenation(nn.Module):
    """An MLP over the concatenated slots: tied to their number and order, so not equivariant to permutations."""

    def __init__(self, input_dim: int, hidden_dim: int, *, layers: int, num_slots: int) -> None:
        super().__init__()
        self.network = mlp(num_slots * input_dim, num_slots * hidden_dim, layers)

    @staticmethod
    def together(parts: Sequence[tuple["Concatenation", Affine]], presence: Tensor, constant: Tensor) -> Step:
        """See `Interactions`; absent slots count as zero."""

        def features(module: "Concatenation", nodes: Tensor) -> Tensor:
            slots, graphs = presence.shape
            seen = nodes.view(slots, graphs, -1) * presence[..., None]
            found: Tensor = module.network(seen.transpose(0, 1).flatten(1))
            return found.view(graphs, slots, -1).transpose(0, 1).flatten(0, 1)

        def step(position: Tensor) -> list[Tensor]:
            nodes = torch.cat([position, constant], dim=1)
            return [readout(features(module, nodes)) for module, readout in parts]

        return step
