"""Canonical frames: a rotation or reflection of (x, y) per experiment, so that equivalent experiments look equal to a network.

- collision: the x axis is the heading of the moving object in AB, and the other object of C is on the left of it.
- balls: the walls have the symmetries of a square, by which the fastest ball of AB starts at 0 to 45°.
- blocktower: likewise, the mean displacement of the blocks at the end of AB points to 0 to 45°.

The origin stays, since balls have walls, and networks that see offsets between objects need none.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from cophy.errors import CophyError
from cophy.types import HORIZONTAL, POSE_ANGLES, Inputs, Prediction

SCENARIOS = ("collision", "balls", "blocktower")
EPSILON = 1e-12


def check_frame(name: str | None) -> None:
    """Raise a CophyError if a scenario has no canonical frame."""
    if name is not None and name not in SCENARIOS:
        raise CophyError(f"model.canonical_frame={name} must be one of {', '.join(SCENARIOS)}")


def predict_in_frame(predict: Callable[[Inputs], Prediction], inputs: Inputs, scenario: str | None) -> Prediction:
    """Predict D in the canonical frame of each experiment, and turn it back; without a scenario in the frame of the inputs."""
    if scenario is None:
        return predict(inputs)
    matrices = canonical_matrices(inputs, scenario)
    prediction = predict(turn_inputs(inputs, matrices))
    return replace(prediction, position=turn(prediction.position, matrices.transpose(1, 2)))


def canonical_matrices(inputs: Inputs, scenario: str) -> Float[Tensor, "batch 2 2"]:
    """Return the matrix of each experiment that takes (x, y) to its canonical frame."""
    seen = inputs.observed_presence[:, None, :, None]
    motion = ((inputs.observed - inputs.observed[:, :1]) * seen)[..., :2]
    if scenario == "blocktower":
        return octant(motion[:, -1].sum(dim=1))
    fastest = motion[:, 1].norm(dim=-1).argmax(dim=1)
    experiments = torch.arange(len(motion), device=motion.device)
    heading = motion[experiments, 1, fastest]
    if scenario == "balls":
        return octant(heading)
    x, y = (heading / heading.norm(dim=-1, keepdim=True).clamp(min=EPSILON)).unbind(dim=-1)
    offset = (inputs.initial - inputs.initial[experiments, fastest][:, None])[..., :2] * inputs.presence[..., None]
    cross = (x[:, None] * offset[..., 1] - y[:, None] * offset[..., 0]).sum(dim=1)
    side = torch.where(cross < 0, -1.0, 1.0)
    return torch.stack([torch.stack([x, y], dim=-1), side[:, None] * torch.stack([-y, x], dim=-1)], dim=1)


def octant(vector: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2 2"]:
    """Return the symmetry of the square that turns each vector to 0 to 45°."""
    signs = torch.diag_embed(torch.where(vector < 0, -1.0, 1.0))
    return torch.where((vector[..., 1].abs() > vector[..., 0].abs())[..., None, None], signs.flip(-2), signs)


def turn(
    vectors: Float[Tensor, "batch *any dims"], matrices: Float[Tensor, "batch 2 2"]
) -> Float[Tensor, "batch *any dims"]:
    """Apply the matrix of each experiment to x and y; z, if there is one, stays."""
    xy = torch.einsum("bij,b...j->b...i", matrices.to(vectors), vectors[..., :2])
    return torch.cat([xy, vectors[..., 2:]], dim=-1)


def turn_columns(
    features: Float[Tensor, "batch slots features"], parts: list[tuple[list[int], Float[Tensor, "batch 2 2"]]]
) -> Float[Tensor, "batch slots features"]:
    """Apply matrices to some columns of features, two at a time."""
    turned = features.clone()
    for columns, matrices in parts:
        turned[..., columns] = turn(features[..., columns], matrices)
    return turned


def turn_inputs(inputs: Inputs, matrices: Float[Tensor, "batch 2 2"]) -> Inputs:
    """Return AB, C, poses and true confounders in the frames of these matrices."""
    pose, confounders = inputs.pose, inputs.confounders
    if confounders is not None:  # their statistics commute with rotations, see `confounder_statistics`
        confounders = turn_columns(confounders, [(columns, matrices) for columns in HORIZONTAL])
    if pose is not None:
        doubled = doubled_angles(matrices)
        multiples = {1: matrices, 2: doubled, 4: doubled_angles(doubled)}
        pose = turn_columns(pose, [(POSE_ANGLES[n], multiple) for n, multiple in multiples.items()])
    observed, initial = (turn(positions, matrices) for positions in (inputs.observed, inputs.initial))
    return replace(inputs, observed=observed, initial=initial, pose=pose, confounders=confounders)


def doubled_angles(matrices: Float[Tensor, "batch 2 2"]) -> Float[Tensor, "batch 2 2"]:
    """Return the matrices that act on (cos 2ψ, sin 2ψ) when the given ones act on (cos ψ, sin ψ)."""
    (cos, sin), (other_cos, other_sin) = matrices[:, :, 0].unbind(1), matrices[:, :, 1].unbind(1)
    mirrored = cos * other_sin - sin * other_cos  # the determinant: 1, or -1 for a reflection
    cos_twice, sin_twice = cos.square() - sin.square(), 2 * cos * sin
    first, second = (cos_twice, sin_twice), (-mirrored * sin_twice, mirrored * cos_twice)
    return torch.stack([torch.stack(column, dim=-1) for column in (first, second)], dim=-1)
