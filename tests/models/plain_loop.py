"""Every predictor as a loop over experiments, steps and objects: what the batched form is held against.

Only the networks' weights are used, and their smallest parts: linear layers, MLPs and recurrent cells.
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from cophy.models.baselines import InteractionNetwork
from cophy.models.cophynet import ConfounderSource, CoPhyNet, Gating, Rollout
from cophy.models.layers import GraphConvolution, PairwiseMLP
from cophy.types import Inputs, Prediction, take

Nodes = dict[int, Tensor]  # slot of a present object -> its features


def edge_function(f: PairwiseMLP, receiver: Tensor, sender: Tensor) -> Tensor:
    """f as one MLP on a receiver and a sender side by side."""
    weight = torch.cat([f.receiver.weight, f.sender.weight], dim=1)
    first = torch.relu(linear(torch.cat([receiver, sender]), weight, f.receiver.bias))
    return f.further(first)


def convolve(interaction: nn.Module, nodes: Nodes, num_slots: int) -> Nodes:
    """Eq. 1 for each object, or what replaces it in the ablation `mlp`."""
    if not isinstance(interaction, GraphConvolution):
        width = len(next(iter(nodes.values())))
        slots = [nodes.get(k, torch.zeros(width)) for k in range(num_slots)]
        found = interaction.network(torch.cat(slots)).view(num_slots, -1)
        return {k: found[k] for k in nodes}
    received = {}
    for k in nodes:
        messages = [edge_function(interaction.f, nodes[k], nodes[j]) for j in nodes if j != k]
        received[k] = (
            torch.stack(messages).mean(dim=0) if messages else torch.zeros(interaction.f.receiver.out_features)
        )
    everything = torch.stack(list(received.values())).mean(dim=0)
    return {k: interaction.g(torch.cat([nodes[k], received[k], everything])) for k in nodes}


def predict(network: nn.Module, inputs: Inputs) -> Prediction:
    """All experiments, one after the other; empty slots are zero."""
    one = cophynet if isinstance(network, CoPhyNet) else interaction_network
    each = [one(network, take(inputs, slice(n, n + 1))) for n in range(len(inputs))]
    fields = zip(*each, strict=True)
    position, logit, estimate = (None if part[0] is None else torch.stack(part) for part in fields)
    return Prediction(position, logit, estimate)


def present(presence: Tensor) -> list[int]:
    return presence[0].nonzero().flatten().tolist()


def cophynet(network: CoPhyNet, inputs: Inputs) -> tuple[Tensor, Tensor, Tensor | None]:
    """One experiment (paper Sec. 4): positions (steps, K, 3), logits (steps or 1, K) and U (K, hidden)."""
    num_slots, num_steps = inputs.presence.shape[1], inputs.num_steps
    u = {k: torch.zeros(0) for k in present(inputs.observed_presence)}
    if network.source is ConfounderSource.estimated:
        u = estimate(network, inputs)
    if network.source is ConfounderSource.ground_truth:
        u = {k: inputs.confounders[0, k] for k in u}
    looks = looks_of(network, inputs)
    known = {k: torch.cat([u[k], looks[k]]) for k in u}
    start = {k: inputs.initial[0, k] for k in present(inputs.presence)}
    unroll = rollout if isinstance(network.decoder, Rollout) else single_step
    positions, logits = unroll(network.decoder, start, known, num_slots, num_steps)
    width = network.estimate_dim
    stacked = torch.stack([u.get(k, torch.zeros(width)) for k in range(num_slots)]) if width else None
    return in_slots(positions, num_slots, 3), in_slots(logits, num_slots, 1).squeeze(-1), stacked


def looks_of(network: nn.Module, inputs: Inputs) -> Nodes:
    """What the network is told of every object of AB: its type, then its pose."""
    told = [inputs.object_type] if network.appearance.object_type else []
    told += [inputs.pose] if network.appearance.pose else []
    return {k: torch.cat([torch.zeros(0), *(part[0, k] for part in told)]) for k in present(inputs.observed_presence)}


def in_slots(steps: list[Nodes], num_slots: int, width: int) -> Tensor:
    return torch.stack([torch.stack([step.get(k, torch.zeros(width)) for k in range(num_slots)]) for step in steps])


def estimate(network: CoPhyNet, inputs: Inputs) -> Nodes:
    """U of every object of AB."""
    looks, frames = looks_of(network, inputs), []
    for frame in inputs.observed[0]:
        nodes = {k: torch.cat([frame[k], looks[k]]) for k in looks}
        frames.append(convolve(network.estimator.convolution, nodes, len(frame)))
    return {k: network.estimator.gru(torch.stack([frame[k] for frame in frames]))[0][-1] for k in looks}


def moved_share(decoder: nn.Module, logit: Tensor) -> Tensor:
    """The gate σ((1 - s)/λ)."""
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
        dynamics, moved = convolve(decoder.dynamics, nodes, num_slots), {}
        for k in nodes:
            state = dynamics[k]
            for layer, cell in enumerate(decoder.cells):
                hidden[k][layer] = state = cell(state, hidden[k][layer])
            moved[k] = position[k] + moved_share(decoder, logits[-1][k]) * decoder.to_displacement(state)
        position = moved
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
    positions = [{k: start[k] + moved_share(decoder, logit[k][t]) * delta[k][t] for k in nodes} for t in steps]
    return positions, [{k: logit[k][t : t + 1] for k in nodes} for t in steps]


def interaction_network(network: InteractionNetwork, inputs: Inputs) -> tuple[Tensor, None, None]:
    """One experiment of IN, or of NPE: positions (steps, K, 3)."""
    objects = present(inputs.presence)
    looks = looks_of(network, inputs)
    given = {k: inputs.confounders[0, k] if network.confounders else torch.zeros(0) for k in objects}
    position, positions = {k: inputs.initial[0, k] for k in objects}, []
    displacement = {k: torch.zeros(3) for k in objects}
    for _ in range(inputs.num_steps):
        state = {k: torch.cat([position[k], displacement[k], given[k], looks[k]]) for k in objects}
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
