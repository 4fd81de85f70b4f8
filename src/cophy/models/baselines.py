"""Baselines: copy C, copy B, replay of AB, the Interaction Network (IN) and the Neural Physics Engine (NPE)."""

from dataclasses import replace
from enum import Enum
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import one_hot

from cophy.errors import CophyError
from cophy.models.layers import (
    Appearance,
    PairwiseMLP,
    check_at_least,
    check_layers,
    check_positive,
    mlp,
    pack,
    parse_option,
    radius_graph,
    unpack,
)
from cophy.types import CONFOUNDERS, NUM_WITHOUT_POSE, Inputs, Prediction, true_confounders


class CopyC(nn.Module):
    """Copy C predicts that nothing moves: D is C and every object is stable (paper Tables 1-4, 6, 7)."""

    def forward(self, inputs: Inputs) -> Prediction:
        """Repeat the initial positions for every step."""
        position = inputs.initial[:, None].repeat(1, inputs.num_steps, 1, 1)
        return Prediction(position, stable_logit=torch.ones_like(position[..., 0]))


class CopyB(nn.Module):
    """Copy B predicts the observed outcome: the do-operation changes nothing (paper Tables 1-4, 6, 7)."""

    def forward(self, inputs: Inputs) -> Prediction:
        """Repeat the observed positions and stability, step for step."""
        seen = inputs.observed_presence[:, None]  # an object that a de-renderer missed in AB stays where it is in C
        position = torch.where(seen[..., None], inputs.observed[:, 1:], inputs.initial[:, None])
        stable = inputs.observed_stable | (inputs.presence[:, None] & ~seen)
        return Prediction(position, stable_logit=2 * stable.to(position.dtype) - 1)


class DisplacedCopyB(CopyB):
    """Copy B, shifted by the do-operation: an object that C displaces moves as in AB, from its new position."""

    def forward(self, inputs: Inputs) -> Prediction:
        """Add C - A of each object to copy B; it is zero except for a displaced object."""
        copy = super().forward(inputs)
        both = (inputs.presence & inputs.observed_presence)[..., None]
        displacement = torch.where(both, inputs.initial - inputs.observed[:, 0], 0.0)
        return replace(copy, position=copy.position + displacement[:, None])


class Touch(NamedTuple):
    """Where two discs first touch if the moving one keeps its heading. Lengths in metres; (x, y) of the moving, then the static.

    Attributes:
        distance: How far the moving one goes until then.
        hits: Whether they touch.
        position: Their positions then.
        axes: Unit vectors along and across the line of centres, from the moving one to the static one.
    """

    distance: Float[Tensor, "batch 1"]
    hits: Bool[Tensor, "batch 1"]
    position: Float[Tensor, "batch 2 2"]
    axes: Float[Tensor, "batch 2 2"]


def find_contact(start: Float[Tensor, "batch 2 2"], heading: Float[Tensor, "batch 2"], diameter: float) -> Touch:
    """Return the contact of two discs, the first of which moves along the heading, a unit vector."""
    across = rotate_quarter(heading)
    between = start[:, 1] - start[:, 0]
    ahead, offset = ((between * each).sum(dim=-1, keepdim=True) for each in (heading, across))
    depth = (diameter**2 - offset.square()).clamp(min=0).sqrt()
    line = (depth * heading + offset.clamp(-diameter, diameter) * across) / diameter
    position = torch.stack([start[:, 0] + (ahead - depth) * heading, start[:, 1]], dim=1)
    axes = torch.stack([line, rotate_quarter(line)], dim=1)
    return Touch(ahead - depth, (offset.abs() < diameter) & (ahead > 0), position, axes)


def rotate_quarter(vector: Float[Tensor, "*any 2"]) -> Float[Tensor, "*any 2"]:
    """Rotate by 90° to the left."""
    return torch.stack([-vector[..., 1], vector[..., 0]], dim=-1)


class Replay(nn.Module):
    """Replay of AB for collisions: AB's response in the frame of its line of centres, applied to C's.

    The moving object of AB goes straight on in C until the objects touch. From then on, with n along the line of centres, t
    across it, u the unit vector of the heading, and AB and D relative to the positions at the contact,

        D_n = u_n^C AB_n / max(u_n^A, ε)        D_t = u_t^C (u_t^A AB_t + ε² P) / ((u_t^A)² + ε²)

    at equal times after it. A head-on AB does not show the response across, so that it is shrunk towards a prior P: the
    moving object keeps a share of its speed, the other one gets none.

    Args:
        diameter: Of both objects, metres; None in a scenario without collisions of two objects.
        kept_speed: Share of the moving object's speed across the line of centres in the prior.
        shrinkage: ε, the sine of the angle of impact in AB at which the prior counts as much as AB; also the smallest cosine
            of that angle, so that a grazing impact is not blown up.

    Raises:
        CophyError: The scenario is another one, or an argument is out of its range.
    """

    def __init__(self, *, diameter: float | None, kept_speed: float, shrinkage: float) -> None:
        super().__init__()
        if diameter is None:
            raise CophyError("model=replay: it needs one impact of two objects, so use scenario=collision")
        check_positive(diameter=diameter, kept_speed=kept_speed, shrinkage=shrinkage)
        self.diameter, self.kept_speed, self.shrinkage = diameter, kept_speed, shrinkage

    def forward(self, inputs: Inputs) -> Prediction:
        """Replay AB; where it shows no impact of two objects, predict displaced copy B."""
        copy = DisplacedCopyB()(inputs).position
        both = inputs.presence & inputs.observed_presence
        step = torch.where(both[..., None], inputs.observed[:, 1] - inputs.observed[:, 0], 0.0)[..., :2]
        moving = one_hot(step.norm(dim=-1).argmax(dim=1), both.shape[1]).bool()
        slots = torch.stack([moving, both & ~moving], dim=1).long().argmax(dim=-1)  # of the moving, the static object
        ab, c = (_objects(each, slots) for each in (inputs.observed, inputs.initial[:, None]))

        velocity = ab[:, 1, 0] - ab[:, 0, 0]  # metres per frame
        speed = velocity.norm(dim=-1, keepdim=True).clamp(min=torch.finfo(velocity.dtype).tiny)
        heading = velocity / speed
        a_contact, c_contact = (find_contact(each[:, 0], heading, self.diameter) for each in (ab, c))
        frames = torch.arange(1, inputs.num_steps + 1, device=c.device)
        after = frames - c_contact.distance / speed  # frames since the contact
        response = _at(ab, after + a_contact.distance / speed) - a_contact.position[:, None]
        response = self._transferred(response, after * speed, a_contact.axes, c_contact.axes, heading)

        has_touched = ((after > 0) & c_contact.hits)[..., None, None]
        free = c + torch.stack(
            [frames[:, None] * velocity[:, None], torch.zeros_like(after)[..., None].expand(-1, -1, 2)], dim=2
        )
        position = torch.where(has_touched, c_contact.position[:, None] + response, free)
        is_impact = (both.sum(dim=1, keepdim=True) == 2) & a_contact.hits
        position = torch.where(is_impact[..., None, None], position, _objects(copy, slots))
        index = slots[:, None, :, None].expand_as(position)
        return Prediction(torch.cat([copy[..., :2].scatter(2, index, position), copy[..., 2:]], dim=-1))

    def _transferred(
        self,
        response: Float[Tensor, "batch steps 2 2"],
        path: Float[Tensor, "batch steps"],
        a_axes: Float[Tensor, "batch 2 2"],
        c_axes: Float[Tensor, "batch 2 2"],
        heading: Float[Tensor, "batch 2"],
    ) -> Float[Tensor, "batch steps 2 2"]:
        """Turn AB's response, displacements of both objects since the contact, into that of C.

        Args:
            path: How far the moving object would have gone without the contact, metres.
        """
        along, across = torch.einsum("bij,bsoj->ibso", a_axes, response)
        (a_along, a_across), (c_along, c_across) = (
            torch.einsum("bij,bj->ib", axes, heading)[..., None, None] for axes in (a_axes, c_axes)
        )
        prior = self.kept_speed * torch.stack([path, torch.zeros_like(path)], dim=-1)
        along = c_along * along / a_along.clamp(min=self.shrinkage)
        weight = self.shrinkage**2
        across = c_across * (a_across * across + weight * prior) / (a_across.square() + weight)
        return torch.einsum("bij,ibso->bsoj", c_axes, torch.stack([along, across]))


def _objects(
    position: Float[Tensor, "batch time slots 3"], slots: Int[Tensor, "batch 2"]
) -> Float[Tensor, "batch time 2 2"]:
    """Return x and y of two objects, given their slots."""
    index = slots[:, None, :, None].expand(-1, position.shape[1], -1, 2)
    return position[..., :2].gather(2, index)


def _at(
    positions: Float[Tensor, "batch time 2 2"], frame: Float[Tensor, "batch steps"]
) -> Float[Tensor, "batch steps 2 2"]:
    """Interpolate positions at fractional frames; before the first and after the last one, they rest."""
    last = positions.shape[1] - 1
    frame = frame.clamp(0, last)
    earlier = frame.long().clamp(max=last - 1)
    fraction = (frame - earlier)[..., None, None]
    start, end = (positions.gather(1, index[..., None, None].expand(-1, -1, 2, 2)) for index in (earlier, earlier + 1))
    return torch.lerp(start, end, fraction)


class ConfounderInput(Enum):
    """True confounders that an interaction network can see: all of `CONFOUNDERS`, or only those that no image shows."""

    ground_truth = "ground_truth"
    without_pose = "without_pose"

    @property
    def width(self) -> int:
        """Number of features."""
        return len(CONFOUNDERS) if self is ConfounderInput.ground_truth else NUM_WITHOUT_POSE


class InteractionNetwork(nn.Module):
    """Feedforward baselines IN and NPE, which see C and never AB (paper, appendix).

    Both predict the next displacement of an object from its state and the effects of others on it:

        e^k = Σ_j f(o^k, o^j)        Δ^k = g(o^k, e^k)        position_{t+1}^k = position_t^k + Δ^k

    The state o is [position, displacement of the previous step]; the first displacement is zero. True confounders,
    object types and poses are appended where they are enabled. The Interaction Network (Battaglia et al., NIPS 2016)
    sums over all other objects. The Neural Physics Engine (Chang et al., ICLR 2017) sums over those within a radius.

    Args:
        hidden_dim: Width of f and g.
        edge_layers: Linear layers of f, at least 2.
        node_layers: Linear layers of g.
        radius: Metres within which objects act on each other; None for all (Interaction Network).
        confounders: `ground_truth` makes the true confounders part of the state ("IN sup."), `without_pose` all but
            shape and orientation; None none.
        object_type: Whether the model sees the type of each object.
        pose: Whether the model sees the orientation of each object at t = 0.

    Raises:
        CophyError: An argument is out of its range.
    """

    def __init__(
        self,
        *,
        hidden_dim: int,
        edge_layers: int,
        node_layers: int,
        radius: float | None,
        confounders: ConfounderInput | str | None,
        object_type: bool = False,
        pose: bool = False,
    ) -> None:
        super().__init__()
        check_at_least(1, hidden_dim=hidden_dim)
        check_layers(1, node_layers=node_layers)
        check_layers(2, edge_layers=edge_layers)
        check_positive(radius=radius)
        self.radius, self.num_confounders = radius, 0
        if confounders is not None:
            self.num_confounders = parse_option(ConfounderInput, "confounders", confounders).width
        self.appearance = Appearance(object_type, pose)
        state_dim = 6 + self.num_confounders + self.appearance.width
        self.f = PairwiseMLP(state_dim, hidden_dim, layers=edge_layers)
        self.g = mlp(state_dim + hidden_dim, hidden_dim, node_layers, output_dim=3)

    def forward(self, inputs: Inputs) -> Prediction:
        """Roll D out from C, one step per frame of AB after the first."""
        packed, slots = pack(inputs)
        confounders = packed.initial[..., :0]
        if self.num_confounders:
            confounders = true_confounders(packed, self.num_confounders)
        constant = self.appearance.concatenate_to(confounders, packed)
        position, positions = packed.initial, []
        displacement = torch.zeros_like(position)
        for _ in range(inputs.num_steps):
            state = torch.cat([position, displacement, constant], dim=-1)
            graph = radius_graph(position, packed.presence, self.radius)
            effects = graph.sum_over_senders(self.f(state))
            displacement = self.g(torch.cat([state, effects], dim=-1))
            position = position + displacement
            positions.append(position)
        return unpack(Prediction(torch.stack(positions, dim=1)), slots, inputs.presence.shape[1])
