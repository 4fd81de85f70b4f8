"""A training goes on from weights, or is spared by them, only where they fit its model."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from cophy.errors import CophyError
from cophy.training.checkpoints import Origin, check_resumable, check_trained, read_bytes, read_checkpoint
from tests.training.trained.saved import model_of, saved, weights_of


def checkpoint(path: Path, model: dict[str, Any], weights: dict[str, Tensor]) -> tuple[Path, Origin]:
    """One to go on from, and what it says of itself."""
    content = torch.load(saved(path, model, weights, seed=0), weights_only=True)
    torch.save(content | {"optimizer_states": []}, path)
    return path, read_checkpoint(read_bytes(path), path).origin


@pytest.mark.parametrize("check", [check_resumable, check_trained])
def test_weights_of_other_shapes_are_refused_by_name(tmp_path: Path, check: Callable[[Path, Origin], None]) -> None:
    model = model_of("model=in")
    weights = weights_of(model)
    check(*checkpoint(tmp_path / "whole.ckpt", model, weights))
    name = min(weights)
    cut, origin = checkpoint(tmp_path / "cut.ckpt", model, weights | {name: weights[name][:1]})
    with pytest.raises(CophyError, match=rf"cut\.ckpt is no checkpoint .*\({name} does not fit .*InteractionNetwork"):
        check(cut, origin)
