"""Networks as conf/ has them, and random experiments to feed them."""

from dataclasses import fields

import torch
from torch import Tensor, nn

from cophy.config import composed, to_plain
from cophy.training.checkpoints import build_network
from cophy.types import CONFOUNDERS, OBJECT_TYPES, POSE, Batch, Inputs, Prediction, Targets

ABLATIONS = ("full", "static_gating", "mlp", "single_step", "feedforward", "gt_confounders")
ALONGSIDE = (
    "alongside",
    *(f"alongside_no_{part}" for part in ("replay", "impulses", "pair_memory")),
)
INTERACTION_NETWORKS = ("in", "npe", "in gt_confounders", "npe gt_confounders")
OTHERS = (*INTERACTION_NETWORKS, "copy_b", "copy_c", *ALONGSIDE)
SEES_LOOKS = ("model.object_type=true", "model.pose=true")


def build(choice: str, *overrides: str) -> nn.Module:
    """The network of "model ablation" as conf/ has it, or of a CoPhyNet ablation; its weights follow from seed 0."""
    model, _, ablation = f"cophynet {choice}".partition(" ") if choice in ABLATIONS else choice.partition(" ")
    config = composed("train", f"model={model}", f"ablation={ablation or 'full'}", *overrides)
    torch.manual_seed(0)
    return build_network(to_plain(config.model))


def random_batch(num_slots: int, num_objects: list[int], num_frames: int = 30) -> Batch:
    """Random experiments of so many objects each; from every second one, the do-operation removes one."""
    size, generator = len(num_objects), torch.Generator().manual_seed(0)
    order = torch.rand(size, num_slots, generator=generator).argsort(dim=1)
    observed_presence = order < torch.tensor(num_objects)[:, None]
    presence = observed_presence & ((order > 0) | (torch.arange(size) % 2 == 0)[:, None])

    def random(*shape: int) -> Tensor:
        return torch.randn(size, *shape, generator=generator)

    inputs = Inputs(
        observed=random(num_frames, num_slots, 3) * observed_presence[:, None, :, None],
        observed_presence=observed_presence,
        observed_stable=random(num_frames - 1, num_slots) > 0,
        initial=random(num_slots, 3) * presence[..., None],
        presence=presence,
        confounders=random(num_slots, len(CONFOUNDERS)) * observed_presence[..., None],
        object_type=random(num_slots, len(OBJECT_TYPES)) * observed_presence[..., None],
        pose=random(num_slots, len(POSE)) * observed_presence[..., None],
    )
    targets = Targets(
        position=random(num_frames - 1, num_slots, 3),
        stable=random(num_frames - 1, num_slots) > 0,
        presence=presence,
        initial=inputs.initial,
        observed_presence=observed_presence,
        confounder_class=torch.zeros(size, num_slots, 2, dtype=torch.long),
        pair=torch.arange(size) // 2,
        cell=torch.zeros(size, dtype=torch.long),
    )
    return Batch(inputs, targets)


def permuted(inputs: Inputs, order: list[int]) -> Inputs:
    """The same experiments with their slots in another order; what is not among the inputs stays so."""
    axes = {"observed": 2, "observed_stable": 2}
    tensors = {each.name: getattr(inputs, each.name) for each in fields(inputs)}
    given = {name: tensor for name, tensor in tensors.items() if tensor is not None}
    return Inputs(**{name: t.index_select(axes.get(name, 1), torch.tensor(order)) for name, t in given.items()})


def present(prediction: Prediction, inputs: Inputs) -> Tensor:
    """Positions of the objects that are there; zero for all others."""
    return prediction.position * inputs.presence[:, None, :, None]
