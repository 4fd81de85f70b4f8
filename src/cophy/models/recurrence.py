"""Gated recurrent units (torch.nn.GRU, its equations and weights) with few operations per step.

Their input half comes ready multiplied: over all steps at once, or folded into the layer before.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from cophy.models.affine import Affine


class GRULayer(NamedTuple):
    """What a layer multiplies its input with, and its state; each gives the gates r, z, n, (3·hidden, hidden)."""

    input: Affine
    state: Affine

    def __call__(self, inputs: Tensor, state: Tensor) -> Tensor:
        """The next state (N, hidden); inputs: (N, 3·hidden), already multiplied."""
        following: Tensor = _Gates.apply(inputs, self.state(state), state)  # type: ignore[no-untyped-call]
        return following

    def over_time(self, inputs: Tensor) -> Tensor:
        """States (T, N, hidden) from zero on; inputs: (T, N, 3·hidden), already multiplied."""
        state, states = inputs.new_zeros(inputs.shape[1], inputs.shape[2] // 3), []
        for each in inputs.unbind(0):
            state = self(each, state)
            states.append(state)
        return torch.stack(states)


def layers_of(network: nn.GRU) -> list[GRULayer]:
    """The layers of a recurrent network, first to last."""
    return [GRULayer(Affine(w_ih, b_ih), Affine(w_hh, b_hh)) for w_ih, w_hh, b_ih, b_hh in network.all_weights]


def layers(cells: Iterable[Any]) -> list[GRULayer]:
    """The same of single cells on top of each other."""
    return [GRULayer(Affine(c.weight_ih, c.bias_ih), Affine(c.weight_hh, c.bias_hh)) for c in cells]


class _Gates(torch.autograd.Function):
    """r, z = σ(i + s), n = tanh(i_n + r s_n), the next state (1 - z) n + z h, and its derivative.

    tanh(x) is written 2σ(2x) - 1: on CPUs, torch's σ takes a fifth of the time.
    """

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, states: Tensor, hidden: Tensor) -> Tensor:
        width = hidden.shape[-1]
        gates_in, new_in = inputs.split_with_sizes([2 * width, width], dim=1)
        gates_of_state, recurrent = states.split_with_sizes([2 * width, width], dim=1)
        gates = torch.add(gates_in, gates_of_state).sigmoid_()
        reset, update = gates.chunk(2, dim=1)
        new = torch.addcmul(new_in, reset, recurrent).mul_(2).sigmoid_().mul_(2).sub_(1)
        ctx.save_for_backward(gates, recurrent, new, hidden)
        return torch.lerp(new, hidden, update)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        gates, recurrent, new, hidden = ctx.saved_tensors
        width = hidden.shape[-1]
        reset, update = gates.chunk(2, dim=1)
        grad_inputs = grad.new_empty(len(grad), 3 * width)
        grad_gates, grad_new = grad_inputs.split_with_sizes([2 * width, width], dim=1)
        grad_reset, grad_update = grad_gates.chunk(2, dim=1)
        grad_hidden = grad * update
        torch.sub(grad, grad_hidden, out=grad_new)
        grad_new.addcmul_(grad_new * new, new, value=-1)
        torch.mul(grad_new, recurrent, out=grad_reset)
        torch.mul(grad, hidden - new, out=grad_update)
        torch.ops.aten.sigmoid_backward.grad_input(grad_gates, gates, grad_input=grad_gates)
        grad_states = grad_inputs.clone()
        grad_states[:, 2 * width :].mul_(reset)
        return grad_inputs, grad_states, grad_hidden
