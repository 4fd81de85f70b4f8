"""The one builder of multi-layer perceptrons."""

from itertools import pairwise

from torch import nn


def mlp(
    input_dim: int, hidden_dim: int, num_layers: int, output_dim: int | None = None, *, inplace: bool = False
) -> nn.Sequential:
    """Linear layers with ReLU between them (paper, appendix).

    Args:
        input_dim: Features of the input.
        hidden_dim: Width of every layer but the last.
        num_layers: Linear layers.
        output_dim: Width of the last layer; None for `hidden_dim`.
        inplace: Whether ReLU overwrites its input. That saves time where the MLP is given a matrix, and costs some else.
    """
    widths = [input_dim, *[hidden_dim] * (num_layers - 1), output_dim or hidden_dim]
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU(inplace)]
    return nn.Sequential(*layers[:-1])
