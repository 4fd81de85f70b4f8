"""Properties of the de-renderer."""

import pytest
import torch

from cophy.models import Derenderer


def build(readout: str = "attention", num_slots: int = 4, width: int = 4) -> Derenderer:
    torch.manual_seed(0)
    return Derenderer(slots=[str(k) for k in range(num_slots)], resolution=32, width=width, readout=readout)


either_readout = pytest.mark.parametrize("readout", ["attention", "linear"])


def test_the_channels_of_the_paper() -> None:
    with torch.device("meta"):
        paper = Derenderer(slots=[str(k) for k in range(9)], resolution=224, width=64, readout="linear")
    convolutions = [module for module in paper.modules() if isinstance(module, torch.nn.Conv2d)]
    assert [c.out_channels for c in convolutions] == [64, 64, 128, 128, 261, 261, 9, 9]  # 256 rounded up to nine shares
    assert paper.heads.weight.shape == (9, 56 * 56, 4)


@either_readout
def test_shapes(readout: str) -> None:
    output = build(readout, num_slots=9)(torch.rand(2, 3, 32, 32))
    assert output.position.shape == (2, 9, 3)
    assert output.presence_logit.shape == (2, 9)


@either_readout
def test_a_head_sees_its_own_channels_only(readout: str) -> None:
    model = build(readout).eval()
    features = torch.rand(1, 16, 8, 8)
    changed = features.clone()
    changed[:, 4:8] += 1.0  # the second of four shares
    difference = (model.heads(features) - model.heads(changed)).abs().sum(dim=(0, 2))
    assert difference[1] > 0
    assert difference[[0, 2, 3]].sum() == 0


@either_readout
def test_every_parameter_gets_a_gradient(readout: str) -> None:
    model = build(readout)
    output = model(torch.rand(8, 3, 32, 32))
    (output.position.square().sum() + output.presence_logit.sum()).backward()
    assert [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_positions_are_learned_in_units_of_their_spread() -> None:
    model, images = build().eval(), torch.rand(2, 3, 32, 32)
    before = model(images).position
    model.scale_(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([2.0, 2.0, 0.5]))
    expected = torch.tensor([1.0, 2.0, 3.0]) + before * torch.tensor([2.0, 2.0, 0.5])
    torch.testing.assert_close(model(images).position, expected)


@either_readout
def test_one_batch_overfits(readout: str) -> None:
    model, generator = build(readout, num_slots=2, width=8), torch.Generator().manual_seed(0)
    images, positions = torch.zeros(8, 3, 32, 32), torch.rand(8, 2, 3, generator=generator)
    for image, places in zip(images, positions, strict=True):
        for color, (x, y, _) in enumerate(places.tolist()):
            image[color, int(4 + 24 * y) : int(8 + 24 * y), int(4 + 20 * x) : int(8 + 20 * x)] = 1.0
    optimizer = torch.optim.Adam(model.parameters(), lr=0.01)
    for _ in range(100):
        optimizer.zero_grad()
        loss = (model(images).position[..., :2] - positions[..., :2]).square().mean()
        loss.backward()
        optimizer.step()
    assert loss.item() < 0.002  # 0.08 for a constant prediction
