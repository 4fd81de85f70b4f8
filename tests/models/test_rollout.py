"""Limits of rollouts."""

import torch

from cophy.models.rollout import limit_gradient, share_within

BATCH = 4


def test_steps_keep_their_direction() -> None:
    displacement = torch.tensor([[[3.0, 4.0, 0.0], [0.3, 0.4, 0.0]]])
    limited = share_within(2.5, displacement) * displacement
    torch.testing.assert_close(limited, torch.tensor([[[1.5, 2.0, 0.0], [0.3, 0.4, 0.0]]]))


def test_a_large_gradient_of_one_experiment_is_limited() -> None:
    """The others keep theirs, to the bit."""
    start = torch.zeros(BATCH, 2, 3, requires_grad=True)
    scale = torch.tensor([1e9, 0.01, 0.0, 2.0])[:, None, None]
    (limit_gradient(start) * scale).sum().backward()
    assert start.grad is not None
    norms = start.grad.flatten(1).norm(dim=1)
    torch.testing.assert_close(norms, torch.tensor([1 / BATCH, 0.01 * 6**0.5, 0.0, 1 / BATCH]))
    assert torch.equal(start.grad[1], torch.full((2, 3), 0.01))


def test_an_unstable_rollout_has_a_gradient_of_use() -> None:
    """Every step doubles an error; the gradient of the start does not grow with the number of steps, and keeps its sign."""
    start = torch.full((BATCH, 1, 3), 1e-3, requires_grad=True)
    position, loss = start, torch.zeros(())
    for _ in range(60):
        position = limit_gradient(2 * position)
        loss = loss + (position**2).mean()
    loss.backward()
    assert start.grad is not None
    assert (start.grad > 0).all()
    assert start.grad.flatten(1).norm(dim=1).max() <= 2 / BATCH + 1e-6
