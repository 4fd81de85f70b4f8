"""Networks from the names of their classes: what is refused, and that nothing nested is made."""

import pytest
import torch
from torch import Tensor, nn

from cophy.errors import CophyError
from cophy.training.checkpoints import build_network, restore_network
from tests.training.trained.saved import model_of


class Keeps(nn.Module):
    """Keeps its argument."""

    def __init__(self, *, given: object) -> None:
        super().__init__()
        self.given = given


def test_a_model_without_a_class_is_refused() -> None:
    with pytest.raises(CophyError, match="_target_ is missing"):
        build_network({"hidden_dim": 32})


def test_nothing_nested_is_made() -> None:
    nested = {"_target_": "pathlib.Path", "_args_": ["hacked"]}
    network = build_network({"_target_": f"{__name__}.Keeps", "given": nested})
    assert network.given == nested


@pytest.mark.parametrize("special", ["_args_", "_partial_", "_recursive_", "_convert_", 5])
def test_keys_that_hydra_would_obey_are_refused(special: object) -> None:
    with pytest.raises(CophyError, match=f"model.{special} is no argument of a network"):
        build_network({"_target_": "cophy.models.baselines.CopyC", special: True})


def test_an_error_inside_a_network_keeps_its_kind() -> None:
    class_of_error = f"{__name__}.Fails"
    with pytest.raises(ZeroDivisionError):
        build_network({"_target_": class_of_error})


class Fails(nn.Module):
    """Cannot be made."""

    def __init__(self) -> None:
        super().__init__()
        self.share = 1 / 0


@pytest.mark.parametrize(
    "chosen",
    ["cophynet", "cophynet ablation=mlp", "cophynet ablation=single_step", "in", "npe", "alongside", "copy_c"]
    + [f"derenderer model.readout={readout}" for readout in ("attention", "linear")],
)
def test_a_restored_network_is_the_one_that_was_saved(chosen: str) -> None:
    """Also what of it is not saved."""
    model = model_of(*f"model={chosen}".split())
    network = build_network(model)
    restored = restore_network(model, network.state_dict())
    for saved, found in zip(everything(network), everything(restored), strict=True):
        assert torch.equal(saved, found)


class ReadsValues(nn.Module):
    """Needs values to be made, which a network on `meta` has not."""

    def __init__(self, *, width: int, first: int) -> None:
        super().__init__()
        self.first, self.steps = first, torch.linspace(0, 1, width).tolist()
        self.scale = nn.Parameter(torch.ones(width))


def test_a_network_that_needs_values_to_be_made_is_restored() -> None:
    model = {"_target_": f"{__name__}.ReadsValues", "width": 3, "first": 0}
    assert restore_network(model, {"scale": torch.full((3,), 2.0)}).scale.tolist() == [2.0] * 3
    with pytest.raises(RuntimeError, match="size mismatch"):
        restore_network(model, {"scale": torch.zeros(4)})


def everything(network: nn.Module) -> list[Tensor]:
    return [*network.parameters(), *network.buffers()]


def wide(hidden_dim: int) -> dict[str, object]:
    return model_of("model=in") | {"hidden_dim": hidden_dim}


@pytest.mark.parametrize(("hidden_dim", "message"), [(10**9, "is more than 16384"), (2**14, "does not fit")])
def test_weights_are_compared_before_anything_is_allocated(
    hidden_dim: int, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    few, made = build_network(wide(8)).state_dict(), []
    monkeypatch.setattr(nn.Linear, "reset_parameters", lambda layer: made.append(layer.weight.device.type))
    with pytest.raises(CophyError, match=message):
        restore_network(wide(hidden_dim), few)
    assert set(made) <= {"meta"}


def test_weights_that_repeat_a_number_are_not_allocated() -> None:
    with torch.device("meta"):
        shapes = {key: value.shape for key, value in build_network(wide(2**14)).state_dict().items()}
    for number in (torch.zeros(1), torch.zeros(1, device="meta")):
        with pytest.raises(CophyError, match="its weights repeat a few numbers"):
            restore_network(wide(2**14), {key: number.expand(shape) for key, shape in shapes.items()})
