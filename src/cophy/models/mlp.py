"""The one builder of multi-layer perceptrons."""

from itertools import pairwise

from torch import nn


def mlp(input_dim: int, hidden_dim: int, num_layers: int, output_dim: int | None = None) -> nn.Sequential:
    """`num_layers` linear layers of width `hidden_dim` with ReLU between them (paper, appendix); the last of `output_dim`."""
    widths = [input_dim, *[hidden_dim] * (num_layers - 1), output_dim or hidden_dim]
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers[:-1])
