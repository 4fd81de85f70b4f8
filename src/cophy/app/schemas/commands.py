"""One dataclass per command: the types and ranges of its keys, so that a wrong one stops every run before the first.

Scenario, split, size, source, render, model and trainer are groups of conf/.
"""

from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING

from cophy.app.schemas.models import OracleConfig
from cophy.app.schemas.trainer_arguments import TrainerConfig
from cophy.dataset.pictures.needed_frames import FRAMES
from cophy.dataset.source import Source
from cophy.dataset.spec import Size
from cophy.dataset.splits import Split
from cophy.scenario import Balls, Blocktower, Collision, Scenario
from cophy.scenario.rendering.frames import RenderSettings
from cophy.training.settings import Training

MAX_SEED = 2**32 - 1  # of NumPy's global generator, which Lightning seeds
MAX_THREADS = 1024

# positions= -> the splits of which a predictor sees what a de-renderer estimates; of the others it sees the truth
ESTIMATED: dict[str, tuple[str, ...]] = {
    "ground_truth": (),
    "derendered": ("train", "val", "test"),
    "train_ground_truth_test_derendered": ("test",),  # the paper's headline setting
}

SCENARIOS: dict[str, type[Scenario]] = {"blocktower": Blocktower, "balls": Balls, "collision": Collision}


@dataclass
class DataConfig:
    """What every command that touches data takes. num_objects: None for those that the split needs."""

    scenario: Scenario = MISSING
    split: Split = MISSING
    size: Size = MISSING
    num_objects: list[int] | None = None
    data_dir: str = MISSING
    data_seed: int = MISSING

    def __post_init__(self) -> None:
        _at_least(0, data_seed=self.data_seed)
        _check_folders(self)
        if not isinstance(self.scenario, SCENARIOS.get(self.scenario.name, Scenario)):
            raise ValueError(f"scenario.name={self.scenario.name} is the name of another scenario")


@dataclass
class MakeDataConfig(DataConfig):
    """What every command that makes data takes. workers: processes."""

    workers: int = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_least(1, workers=self.workers)


@dataclass
class RenderDataConfig(MakeDataConfig):
    """What every command that renders data takes."""

    render: RenderSettings = MISSING


@dataclass
class GenerateConfig(RenderDataConfig):
    """generate.py. seed: a short name of data_seed. frames: which are rendered. model: None, or an oracle.

    part, parts: see `_check_part`.
    """

    seed: int = MISSING
    frames: str = MISSING
    part: int = MISSING
    parts: int = MISSING
    model: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_part(self.part, self.parts)
        _check_frames(self.frames)
        if not (self.model is None or isinstance(self.model, OracleConfig)):
            raise ValueError("model: only what an oracle says (model=oracle_feedforward) is kept beside data")


@dataclass
class AuditConfig(DataConfig):
    """audit.py. replayed_pairs: twin pairs per dataset that are made and simulated again. seed: as in generate.py."""

    source: Source = MISSING
    replayed_pairs: int = MISSING
    directory: str = MISSING
    seed: int = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_least(1, replayed_pairs=self.replayed_pairs)


@dataclass
class LookConfig(RenderDataConfig):
    """look.py. experiment: shown in time. num_shown: experiments on the contact sheet."""

    experiment: int = MISSING
    num_shown: int = MISSING
    directory: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_least(1, num_shown=self.num_shown)


@dataclass
class ExportConfig(RenderDataConfig):
    """export.py. format: of a released dataset. clips: whether pictures are exported. root: the folder to write to."""

    format: str = MISSING
    clips: bool = MISSING
    root: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.format != "cophy":
            raise ValueError(f"format={self.format} is not cophy, the one format that is written")


@dataclass
class DerenderConfig(MakeDataConfig):
    """derender.py. derenderer: a checkpoint, None for the one that fits among the runs in `outputs`.

    frames: which are looked at. part, parts: see `_check_part`.
    """

    source: Source = MISSING
    derenderer: str | None = None
    outputs: str = MISSING
    frames: str = MISSING
    part: int = MISSING
    parts: int = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_part(self.part, self.parts)
        _check_frames(self.frames)


@dataclass
class TrainConfig(RenderDataConfig):
    """train.py. seed: of the training. render, num_images, num_objects: what a de-renderer is trained on.

    derenderer: checkpoint of the one whose estimates a predictor sees; None finds it in outputs/. model: a schema of
    `models`, or any keys for a model of one's own. logger: a `_target_` and its arguments each.
    """

    source: Source = MISSING
    model: Any = MISSING
    training: Training = MISSING
    trainer: TrainerConfig = MISSING
    logger: dict[str, Any] = field(default_factory=dict)
    positions: str = MISSING
    num_images: int = MISSING
    derenderer: str | None = None
    seed: int = MISSING
    threads: int = MISSING
    figures_every_n_epochs: int = MISSING
    optimized_metric: str = MISSING
    reuse: bool = MISSING
    ckpt: str | None = None
    predictor: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_least(0, seed=self.seed)
        _at_most(MAX_SEED, seed=self.seed)
        _at_most(MAX_THREADS, threads=self.threads)
        _at_least(1, threads=self.threads, figures_every_n_epochs=self.figures_every_n_epochs)
        _at_least(10, num_images=self.num_images)
        if self.ckpt is not None and self.predictor is not None:
            raise ValueError("ckpt= goes on with a training, predictor= spares one: give one of them")
        if self.ckpt is None:
            self.trainer.check_validates()
        if not self.optimized_metric.startswith("val/"):
            raise ValueError(f"optimized_metric={self.optimized_metric} must be of the validation split: val/mse, …")
        if self.positions not in ESTIMATED:
            raise ValueError(f"positions={self.positions} is not among {', '.join(ESTIMATED)}")


@dataclass
class PredictConfig:
    """predict.py, whose YAML explains the keys."""

    observed: str = MISSING
    initial: str = MISSING
    truth: str | None = None
    background: str | None = None
    derenderer: str = MISSING
    predictor: str = MISSING
    directory: str = MISSING

    def __post_init__(self) -> None:
        _check_folders(self)


@dataclass
class ReportConfig:
    """report.py. source: of the data that the runs are on. outputs: where train.py wrote its runs. all: print all."""

    source: Source = MISSING
    outputs: str = MISSING
    data_dir: str = MISSING
    directory: str = MISSING
    all: bool = False

    def __post_init__(self) -> None:
        _check_folders(self)


def _check_folders(config: Any) -> None:
    for key in ("data_dir", "directory", "outputs", "root"):
        if getattr(config, key, None) == "":
            raise ValueError(f"{key}= is empty: it names a folder")


def _check_frames(name: str) -> None:
    if name not in FRAMES:
        raise ValueError(f"frames={name} is not among {', '.join(FRAMES)}")


def _check_part(part: int, parts: int) -> None:
    """Only every `parts`-th shard is made, from `part` on."""
    _at_least(1, parts=parts)
    if not 0 <= part < parts:
        raise ValueError(f"part={part} must be from 0 to parts - 1 = {parts - 1}")


def _at_least(smallest: int, **values: int) -> None:
    for key, value in values.items():
        if value < smallest:
            raise ValueError(f"{key}={value} must be at least {smallest}")


def _at_most(largest: int, **values: int) -> None:
    for key, value in values.items():
        if value > largest:
            raise ValueError(f"{key}={value} must be at most {largest}")
