"""A plain PyTorch training loop on `cophy.load`: an MLP from AB and C to D - C.

python docs/examples/torch_loop.py collision small OUTPUT.npz
"""

import sys

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

import cophy

PER_FRAME = 4  # stored states per frame


def tensors(batch: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the inputs (batch, values), C, D - C and the presence of objects."""
    position, presence = batch["states"][:, :, ::PER_FRAME, :, :3], batch["presence"][:, 1]
    observed, initial, outcome = position[:, 0], position[:, 1, :1], position[:, 1, 1:]
    return torch.cat([observed.flatten(1), initial.flatten(1)], dim=1), initial, outcome - initial, presence


def main(scenario: str, size: str, output: str, epochs: int = 20) -> None:
    """Train, and write a file of predictions of the test split."""
    torch.manual_seed(0)
    data = {split: cophy.load(scenario, split=split, size=size) for split in ("train", "test")}
    inputs, _, motion, _ = tensors(next(iter(DataLoader(data["train"], batch_size=2))))
    model = nn.Sequential(nn.Linear(inputs.shape[1], 256), nn.ReLU(), nn.Linear(256, motion[0].numel()))
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    for _ in range(epochs):
        for batch in DataLoader(data["train"], batch_size=64, shuffle=True):
            inputs, _, motion, presence = tensors(batch)
            error = (model(inputs).view_as(motion) - motion) * presence[:, None, :, None]
            optimizer.zero_grad()
            error.square().mean().backward()
            optimizer.step()
    predicted = []
    with torch.no_grad():
        for batch in DataLoader(data["test"], batch_size=256):
            inputs, initial, motion, _ = tensors(batch)
            predicted.append((initial + model(inputs).view_as(motion)).numpy())
    np.savez_compressed(output, experiment=data["test"].rows, position=np.concatenate(predicted))


if __name__ == "__main__":
    main(*sys.argv[1:])
