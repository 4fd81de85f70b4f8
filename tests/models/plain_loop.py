"""Reference implementation of every predictor as plain loops over experiments, steps and objects.

It shares only the smallest parts with the networks: linear layers, MLPs and recurrent cells.
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from cophy.models import InteractionNetwork
from cophy.models.cophynet import ConfounderSource, CoPhyNet, Gating, Rollout
from cophy.models.layers import GraphConvolution, PairwiseMLP
from cophy.types import CONFOUNDERS, Inputs, Prediction, take

Nodes = dict[int, Tensor]  # slot of a present object -> its features


def edge_function(f: PairwiseMLP, receiver: Tensor, sender: Tensor) -> Tensor:
    """Return f as one MLP on the concatenation of a receiver and a sender."""
    weight = torch.cat([f.receiver.weight, f.sender.weight], dim=1)
    first = torch.relu(linear(torch.cat([receiver, sender]), weight, f.receiver.bias))
    return f.further(first)


def convolve(interaction: nn.Module, nodes: Nodes, num_slots: int) -> Nodes:
    """Apply Eq. 1 to each object, or its replacement in the ablation `mlp`."""
    if not isinstance(interaction, GraphConvolution):
        width = len(next(iter(nodes.values())))
        slots = [nodes.get(k, torch.zeros(width)) for k in range(num_slots)]
        output = interaction.network(torch.cat(slots)).view(num_slots, -1)
        return {k: output[k] for k in nodes}
    received = {}
    for k in nodes:
        messages = [edge_function(interaction.f, nodes[k], nodes[j]) for j in nodes if j != k]
        received[k] = (
            torch.stack(messages).mean(dim=0) if messages else torch.zeros(interaction.f.receiver.out_features)
        )
    everything = torch.stack(list(received.values())).mean(dim=0)
    return {k: interaction.g(torch.cat([nodes[k], received[k], everything])) for k in nodes}


def predict(network: nn.Module, inputs: Inputs) -> Prediction:
    """Predict one experiment after the other; empty slots are zero."""
    one = cophynet if isinstance(network, CoPhyNet) else interaction_network
    each = [one(network, take(inputs, slice(n, n + 1))) for n in range(len(inputs))]
    fields = zip(*each, strict=True)
    position, logit, estimate = (None if part[0] is None else torch.stack(part) for part in fields)
    return Prediction(position, logit, estimate)


def present(presence: Tensor) -> list[int]:
    return presence[0].nonzero().flatten().tolist()


def cophynet(network: CoPhyNet, inputs: Inputs) -> tuple[Tensor, Tensor, Tensor | None]:
    """Predict one experiment (paper Sec. 4). Returns positions (steps, K, 3), logits (steps or 1, K) and U (K, hidden)."""
    num_slots, num_steps = inputs.presence.shape[1], inputs.num_steps
    u = {k: torch.zeros(0) for k in present(inputs.observed_presence)}
    if network.source is ConfounderSource.estimated:
        u = estimate(network, inputs)
    if network.source is ConfounderSource.ground_truth:
        u = {k: inputs.confounders[0, k] for k in u}
    if network.source is ConfounderSource.without_pose:
        u = {k: inputs.confounders[0, k, : CONFOUNDERS.index("cylinder")] for k in u}
    features = appearance(network, inputs)
    constant = {k: torch.cat([u[k], features[k]]) for k in u}
    start = {k: inputs.initial[0, k] for k in present(inputs.presence)}
    unroll = rollout if isinstance(network.decoder, Rollout) else single_step
    positions, logits = unroll(network.decoder, start, constant, num_slots, num_steps)
    width = network.estimate_dim
    stacked = torch.stack([u.get(k, torch.zeros(width)) for k in range(num_slots)]) if width else None
    return in_slots(positions, num_slots, 3), in_slots(logits, num_slots, 1).squeeze(-1), stacked


def appearance(network: nn.Module, inputs: Inputs) -> Nodes:
    """Return type and pose of every object of AB, where the network sees them."""
    columns = [inputs.object_type] if network.appearance.object_type else []
    columns += [inputs.pose] if network.appearance.pose else []
    return {
        k: torch.cat([torch.zeros(0), *(part[0, k] for part in columns)]) for k in present(inputs.observed_presence)
    }


def in_slots(steps: list[Nodes], num_slots: int, width: int) -> Tensor:
    return torch.stack([torch.stack([step.get(k, torch.zeros(width)) for k in range(num_slots)]) for step in steps])


def estimate(network: CoPhyNet, inputs: Inputs) -> Nodes:
    """Return U of every object of AB."""
    features, frames = appearance(network, inputs), []
    for frame in inputs.observed[0]:
        nodes = {k: torch.cat([frame[k], features[k]]) for k in features}
        frames.append(convolve(network.estimator.convolution, nodes, len(frame)))
    return {k: network.estimator.gru(torch.stack([frame[k] for frame in frames]))[0][-1] for k in features}


def gate(decoder: nn.Module, logit: Tensor) -> Tensor:
    """Return σ((1 - s)/λ)."""
    return 1 / (1 + torch.exp(-(1 - logit) / decoder.temperature))


def rollout(
    decoder: Rollout, start: Nodes, u: Nodes, num_slots: int, num_steps: int
) -> tuple[list[Nodes], list[Nodes]]:
    """o_{t+1} = o_t + σ((1 - s_t)/λ) Δ_t, object by object."""
    position, positions, logits = start, [], []
    hidden = {k: [torch.zeros(cell.hidden_size) for cell in decoder.cells] for k in start}
    for step in range(num_steps):
        nodes = {k: torch.cat([position[k], u[k]]) for k in position}
        if step == 0 or decoder.gating is Gating.per_step:
            stability = convolve(decoder.stability, nodes, num_slots)
            logits.append({k: decoder.to_stable_logit(stability[k]) for k in nodes})
        dynamics, new_position = convolve(decoder.dynamics, nodes, num_slots), {}
        for k in nodes:
            state = dynamics[k]
            for layer, cell in enumerate(decoder.cells):
                hidden[k][layer] = state = cell(state, hidden[k][layer])
            new_position[k] = position[k] + gate(decoder, logits[-1][k]) * decoder.to_displacement(state)
        position = new_position
        positions.append(position)
    return positions, logits


def single_step(
    decoder: nn.Module, start: Nodes, u: Nodes, num_slots: int, num_steps: int
) -> tuple[list[Nodes], list[Nodes]]:
    """o_t = o_0 + σ((1 - s_t)/λ) Δ_t, object by object."""
    nodes = {k: torch.cat([start[k], u[k]]) for k in start}
    stability, dynamics = (convolve(part, nodes, num_slots) for part in (decoder.stability, decoder.dynamics))
    logit = {k: decoder.to_stable_logits(stability[k]) for k in nodes}
    delta = {k: decoder.to_displacements(dynamics[k]).view(num_steps, 3) for k in nodes}
    steps = range(num_steps)
    positions = [{k: start[k] + gate(decoder, logit[k][t]) * delta[k][t] for k in nodes} for t in steps]
    return positions, [{k: logit[k][t : t + 1] for k in nodes} for t in steps]


def interaction_network(network: InteractionNetwork, inputs: Inputs) -> tuple[Tensor, None, None]:
    """Predict one experiment with IN or NPE. Returns positions (steps, K, 3)."""
    objects = present(inputs.presence)
    features = appearance(network, inputs)
    confounders = {
        k: inputs.confounders[0, k, : network.num_confounders] if network.num_confounders else torch.zeros(0)
        for k in objects
    }
    position, positions = {k: inputs.initial[0, k] for k in objects}, []
    displacement = {k: torch.zeros(3) for k in objects}
    for _ in range(inputs.num_steps):
        state = {k: torch.cat([position[k], displacement[k], confounders[k], features[k]]) for k in objects}
        effects = {}
        for k in objects:
            near = [j for j in objects if j != k]
            if network.radius is not None:
                near = [j for j in near if (position[j] - position[k]).norm() < network.radius]
            messages = [edge_function(network.f, state[k], state[j]) for j in near]
            effects[k] = sum(messages, torch.zeros(network.f.receiver.out_features))
        displacement = {k: network.g(torch.cat([state[k], effects[k]])) for k in objects}
        position = {k: position[k] + displacement[k] for k in objects}
        positions.append(position)
    return in_slots(positions, inputs.presence.shape[1], 3), None, None
