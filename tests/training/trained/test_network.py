"""Networks from the names of their classes: what is refused, and that nothing nested is made."""

import pytest
from torch import nn

from cophy.errors import CophyError
from cophy.training.trained.network import build_network


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


@pytest.mark.parametrize("special", ["_args_", "_partial_", "_recursive_", "_convert_"])
def test_keys_that_hydra_would_obey_are_refused(special: str) -> None:
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
