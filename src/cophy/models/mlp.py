"""The one builder of multi-layer perceptrons."""

from torch import nn


def mlp(input_dim: int, hidden_dim: int, num_layers: int) -> nn.Sequential:
    """`num_layers` linear layers of width `hidden_dim` with ReLU between them (paper, appendix)."""
    layers: list[nn.Module] = [nn.Linear(input_dim, hidden_dim)]
    for _ in range(num_layers - 1):
        layers += [nn.ReLU(), nn.Linear(hidden_dim, hidden_dim)]
    return nn.Sequential(*layers)
