"""Typed configuration: the schemas under conf/, so that a wrong key or type stops every row before the first runs.

They live in groups of their own (`schema/...`), so that `glob(*)` over scenarios or models finds rows only.
"""

from dataclasses import dataclass
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from cophy.dataset.source import Source
from cophy.dataset.spec import Size
from cophy.dataset.splits import Split
from cophy.model_config import (
    CoPhyNetConfig,
    CopyBConfig,
    CopyCConfig,
    DerendererConfig,
    InteractionNetworkConfig,
    OracleConfig,
)
from cophy.scenario import Balls, Blocktower, Collision
from cophy.scenario.rendering import RenderSettings
from cophy.training.settings import Training

POSITIONS = ("ground_truth", "derendered", "train_ground_truth_test_derendered")  # which positions a predictor may see


@dataclass
class DataConfig:
    """What every command that touches data takes; scenario, split and size are groups."""

    scenario: Any = MISSING
    split: Any = MISSING
    size: Any = MISSING
    num_objects: list[int] | None = None
    data_dir: str = MISSING
    seed: int = MISSING

    def __post_init__(self) -> None:
        _at_least(0, seed=self.seed)


@dataclass
class MakeDataConfig(DataConfig):
    """What every command that makes data takes. workers: processes."""

    workers: int = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_least(1, workers=self.workers)


@dataclass
class GenerateConfig(MakeDataConfig):
    """generate.py. num_objects: None for those the split needs. render is a group."""

    render: Any = MISSING


@dataclass
class AuditConfig(DataConfig):
    """audit.py. replayed_pairs: twin pairs per dataset that are made and simulated again."""

    source: Any = MISSING
    replayed_pairs: int = MISSING
    directory: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_least(1, replayed_pairs=self.replayed_pairs)


@dataclass
class LookConfig(GenerateConfig):
    """look.py. experiment: shown in time. num_shown: experiments on the contact sheet."""

    experiment: int = MISSING
    num_shown: int = MISSING
    directory: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_least(1, num_shown=self.num_shown)


@dataclass
class ExportConfig(GenerateConfig):
    """export.py. format: the layout; root: the folder to write to."""

    format: str = MISSING
    root: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.format != "cophy":
            raise ValueError(f"format={self.format} is not cophy, the one layout that is written")


@dataclass
class DerenderConfig(MakeDataConfig):
    """derender.py. derenderer: a checkpoint, None for the one that fits among the runs in `outputs`."""

    source: Any = MISSING
    derenderer: str | None = None
    outputs: str = MISSING


@dataclass
class TrainerConfig:
    """Arguments of lightning.Trainer that a run may set."""

    max_epochs: int = MISSING
    accelerator: str = MISSING
    devices: Any = MISSING
    precision: str = MISSING
    deterministic: bool = MISSING
    gradient_clip_val: float | None = None
    max_time: str | None = None
    check_val_every_n_epoch: int = 1
    limit_train_batches: Any = None
    limit_val_batches: Any = None
    limit_test_batches: Any = None
    fast_dev_run: bool = False
    log_every_n_steps: int = 50
    enable_progress_bar: bool = True
    enable_model_summary: bool = True
    num_nodes: int = 1
    strategy: str = "auto"
    profiler: str | None = None

    def __post_init__(self) -> None:
        if self.max_epochs == 0 or self.max_epochs < -1:
            raise ValueError(f"trainer.max_epochs={self.max_epochs} must be positive, or -1 for no limit")


@dataclass
class TrainConfig(MakeDataConfig):
    """train.py. data_seed: seed of the dataset; seed: of the training. render, num_frames, num_objects: what a de-renderer is trained on.

    derenderer: checkpoint of the de-renderer whose estimates are seen instead of true positions; None for the one in outputs/.
    """

    source: Any = MISSING
    model: Any = MISSING
    training: Training = MISSING
    trainer: TrainerConfig = MISSING
    positions: str = MISSING
    render: Any = MISSING
    num_frames: int = MISSING
    derenderer: str | None = None
    data_seed: int = MISSING
    threads: int = MISSING
    figures_every_n_epochs: int = MISSING
    reuse: bool = MISSING
    ckpt: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_least(1, threads=self.threads, figures_every_n_epochs=self.figures_every_n_epochs)
        _at_least(10, num_frames=self.num_frames)
        _at_least(0, data_seed=self.data_seed)
        if self.positions not in POSITIONS:
            raise ValueError(f"positions={self.positions} is not among {', '.join(POSITIONS)}")


@dataclass
class PredictConfig:
    """predict.py, whose YAML explains the keys."""

    observed: str = MISSING
    initial: str = MISSING
    truth: str | None = None
    derenderer: str = MISSING
    predictor: str = MISSING
    directory: str = MISSING


@dataclass
class ReportConfig:
    """report.py. source: of the data that the runs are on. outputs: where train.py wrote its runs."""

    source: Any = MISSING
    outputs: str = MISSING
    data_dir: str = MISSING
    directory: str = MISSING


def _at_least(smallest: int, **values: int) -> None:
    for key, value in values.items():
        if value < smallest:
            raise ValueError(f"{key}={value} must be at least {smallest}")


def register() -> None:
    """Make the schemas known to Hydra."""
    store = ConfigStore.instance()
    groups: dict[str, dict[str, type]] = {
        "schema/root": {
            "train": TrainConfig,
            "generate": GenerateConfig,
            "audit": AuditConfig,
            "export": ExportConfig,
            "derender": DerenderConfig,
            "look": LookConfig,
            "predict": PredictConfig,
            "report": ReportConfig,
        },
        "schema/scenario": {"blocktower": Blocktower, "balls": Balls, "collision": Collision},
        "schema/split": {"split": Split},
        "schema/size": {"size": Size},
        "schema/source": {"source": Source},
        "schema/render": {"render": RenderSettings},
        "schema/model": {
            "cophynet": CoPhyNetConfig,
            "interaction_network": InteractionNetworkConfig,
            "derenderer": DerendererConfig,
            "oracle": OracleConfig,
            "copy_c": CopyCConfig,
            "copy_b": CopyBConfig,
        },
    }
    for group, nodes in groups.items():
        for name, node in nodes.items():
            store.store(group=group, name=name, node=node)
