"""Schemas of conf/model/: the arguments of the networks, their types and ranges."""

from dataclasses import dataclass
from typing import Any

from omegaconf import MISSING

from cophy.dataset.store.experiment_set import ORACLES, OracleSettings
from cophy.models.options import ConfounderInput, ConfounderSource, Decoding, Gating, Interaction, Readout


@dataclass
class CoPhyNetConfig:
    """cophy.models.cophynet.CoPhyNet, which explains its arguments."""

    _target_: str = "cophy.models.cophynet.CoPhyNet"
    hidden_dim: int = MISSING
    gru_layers: int = MISSING
    edge_layers: int = MISSING
    node_layers: int = MISSING
    temperature: float = MISSING
    confounders: ConfounderSource = MISSING
    gating: Gating = MISSING
    interaction: Interaction = MISSING
    decoding: Decoding = MISSING
    object_type: bool = MISSING
    pose: bool = MISSING
    num_frames: int | None = None
    slots: Any = None  # a list of names; typed, it would have to be resolved before the scenario is known

    def __post_init__(self) -> None:
        if min(self.hidden_dim, self.gru_layers) < 1 or min(self.node_layers, self.edge_layers) < 2:
            raise ValueError(
                "model: hidden_dim and gru_layers must be at least 1, edge_layers and node_layers at least 2"
            )
        if self.temperature <= 0:
            raise ValueError(f"model.temperature={self.temperature} must be positive")
        if self.decoding is Decoding.single_step and self.num_frames is None:
            raise ValueError("model.decoding=single_step needs model.num_frames, see conf/ablation/single_step.yaml")
        if self.interaction is Interaction.mlp and not self.slots:
            raise ValueError("model.interaction=mlp needs model.slots, see conf/ablation/mlp.yaml")


@dataclass
class AlongsideConfig:
    """cophy.models.alongside.alongside.Alongside, which explains its arguments."""

    _target_: str = "cophy.models.alongside.alongside.Alongside"
    hidden_dim: int = MISSING
    edge_layers: int = MISSING
    temperature: float = MISSING
    arena_half_width: float | None = MISSING
    max_step: float = MISSING
    replay: bool = MISSING
    impulses: bool = MISSING
    pair_memory: bool = MISSING
    object_type: bool = MISSING
    pose: bool = MISSING

    def __post_init__(self) -> None:
        if self.hidden_dim < 1 or self.edge_layers < 2:
            raise ValueError("model: hidden_dim must be at least 1, edge_layers at least 2")
        if self.temperature <= 0:
            raise ValueError(f"model.temperature={self.temperature} must be positive")
        if self.max_step <= 0:
            raise ValueError(f"model.max_step={self.max_step} must be positive")


@dataclass
class InteractionNetworkConfig:
    """cophy.models.baselines.InteractionNetwork, which explains its arguments."""

    _target_: str = "cophy.models.baselines.InteractionNetwork"
    hidden_dim: int = MISSING
    edge_layers: int = MISSING
    node_layers: int = MISSING
    radius: float | None = MISSING
    confounders: ConfounderInput | None = MISSING
    object_type: bool = MISSING
    pose: bool = MISSING

    def __post_init__(self) -> None:
        if min(self.hidden_dim, self.node_layers) < 1 or self.edge_layers < 2:
            raise ValueError("model: hidden_dim and node_layers must be at least 1, edge_layers at least 2")
        if self.radius is not None and self.radius <= 0:
            raise ValueError(f"model.radius={self.radius} must be positive, or null for all objects")


@dataclass
class DerendererConfig:
    """cophy.models.derenderer.Derenderer, which explains its arguments."""

    _target_: str = "cophy.models.derenderer.Derenderer"
    slots: Any = None  # a list of names; typed, it would have to be resolved before the scenario is known
    resolution: int = MISSING
    width: int = MISSING
    readout: Readout = MISSING

    def __post_init__(self) -> None:
        if self.resolution < 8 or self.resolution % 4 or self.width < 1:
            raise ValueError("model: resolution must be a multiple of 4 and at least 8, width at least 1")


@dataclass
class OracleConfig:
    """An oracle, see `cophy.training.runs.oracle`: no network, so nothing is trained. The numbers: see conf/model/."""

    oracle: str = MISSING
    draws: int = MISSING
    max_configurations: int = MISSING
    noise: float = MISSING
    max_experiments: int = MISSING

    def __post_init__(self) -> None:
        if self.oracle not in ORACLES:
            raise ValueError(f"model.oracle={self.oracle} is none of {', '.join(ORACLES)}")
        if self.draws < 4:
            raise ValueError("model.draws must be at least 4: the variance of a mean takes two twin pairs")
        if self.max_configurations < 1 or self.noise <= 0:
            raise ValueError("model: max_configurations must be at least 1 and noise positive")
        if self.max_experiments < 2 or self.max_experiments % 2:
            raise ValueError("model.max_experiments must be even and at least 2: both twins are asked about")

    @property
    def settings(self) -> OracleSettings:
        """What all oracles are asked with."""
        return OracleSettings(self.draws, self.max_configurations, self.noise, self.max_experiments)


@dataclass
class CopyCConfig:
    """Nothing to configure."""

    _target_: str = "cophy.models.baselines.CopyC"


@dataclass
class CopyBConfig:
    """Nothing to configure."""

    _target_: str = "cophy.models.baselines.CopyB"
