"""Types and ranges of the configuration: a dataclass per command, so that a wrong key or type stops a sweep before its first run.

The schemas of models are derived from their constructors; `register` makes all schemas known to Hydra.
"""

from dataclasses import dataclass, field, make_dataclass
from enum import Enum
from functools import cache
from inspect import Parameter, signature
from types import NoneType, UnionType
from typing import Any, Optional, Union, get_args, get_origin, get_type_hints

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from cophy.dataset.experiment_set import FRAMES
from cophy.dataset.source import Source
from cophy.dataset.spec import Size
from cophy.dataset.splits import Split
from cophy.oracles.forecasts import ORACLES, OracleSettings
from cophy.released.states import ReleasedSource
from cophy.report.paper_tables import register_tables
from cophy.scenario import Balls, Blocktower, Collision, Scenario
from cophy.scenario.rendering import RenderSettings
from cophy.study.plan import Limits, StudySettings
from cophy.training.settings import Training


@dataclass
class OracleConfig:
    """An oracle, see `cophy.oracles.run`: no network, so nothing is trained. The numbers: see conf/model/."""

    _target_: str = "cophy.oracles.run.Oracle"
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
class TrainerConfig:
    """Arguments of lightning.Trainer that a run may set."""

    max_epochs: int = MISSING
    accelerator: str = MISSING
    devices: Any = MISSING  # a number, "auto" or a list of numbers; such unions OmegaConf 2.3 cannot merge
    precision: str = MISSING
    deterministic: bool = MISSING
    gradient_clip_val: float | None = None
    max_time: str | None = None
    check_val_every_n_epoch: int = 1
    limit_train_batches: Any = None  # a number of batches, or a share; likewise
    limit_val_batches: Any = None  # a number of batches, or a share
    limit_test_batches: Any = None  # a number of batches, or a share
    fast_dev_run: bool = False
    log_every_n_steps: int = 50
    enable_progress_bar: bool = True
    enable_model_summary: bool = True
    num_nodes: int = 1
    strategy: str = "auto"
    profiler: str | None = None

    def __post_init__(self) -> None:
        for key in ("limit_train_batches", "limit_test_batches"):
            if getattr(self, key) == 0:
                raise ValueError(f"trainer.{key}=0: at least one batch is needed")
        if self.max_epochs == 0 or self.max_epochs < -1:
            raise ValueError(f"trainer.max_epochs={self.max_epochs} must be positive, or -1 for no limit")
        if self.check_val_every_n_epoch < 1:
            raise ValueError(f"trainer.check_val_every_n_epoch={self.check_val_every_n_epoch} must be at least 1")

    def check_validates(self) -> None:
        """Refuse a training that is never validated; one that goes on from a checkpoint may have its best from there.

        Raises:
            ValueError: No epoch is validated, or no batch of it.
        """
        every = self.check_val_every_n_epoch
        if self.max_epochs != -1 and every > self.max_epochs:
            raise ValueError(f"trainer.check_val_every_n_epoch={every} must be at most trainer.max_epochs")
        if self.limit_val_batches == 0:
            raise ValueError("trainer.limit_val_batches=0: at least one batch is needed")


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


ACTIONS = ("serve", "export", "simulate", "power")


@dataclass
class StudyConfig(MakeDataConfig):
    """Configuration of study.py; conf/study.yaml explains the keys."""

    action: str = MISSING
    participants: int = MISSING
    study: StudySettings = MISSING
    limits: Limits = MISSING
    directory: str = MISSING
    welcome: str | None = None
    host: str = MISSING
    port: int = MISSING
    trusted_proxies: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.action not in ACTIONS:
            raise ValueError(f"action={self.action} is not among {', '.join(ACTIONS)}")
        if self.participants < 2:
            raise ValueError(f"participants={self.participants} must be at least 2")
        if not 0 <= self.port < 65536:
            raise ValueError(f"port={self.port} must be from 0 to 65535")


SCHEMAS: dict[str, dict[str, type]] = {
    "root": {
        "train": TrainConfig,
        "generate": GenerateConfig,
        "audit": AuditConfig,
        "export": ExportConfig,
        "derender": DerenderConfig,
        "look": LookConfig,
        "predict": PredictConfig,
        "report": ReportConfig,
        "study": StudyConfig,
    },
    "scenario": {**SCENARIOS},
    "split": {"split": Split},
    "size": {"size": Size},
    "source": {"source": Source, "released": ReleasedSource},
    "render": {"render": RenderSettings},
    "model": {"oracle": OracleConfig},
}


@cache
def register(*, models: bool = False) -> None:
    """Make the schemas known to Hydra, as `schema/<group>/<name>`, and the groups `row` and `table`.

    Args:
        models: Whether to derive and register those of `cophy.models`, too, which imports torch.
    """
    register_tables()
    schemas = {group: dict(choices) for group, choices in SCHEMAS.items()}
    if models:
        import cophy.models

        schemas["model"] |= {name: schema_of(getattr(cophy.models, name)) for name in cophy.models.__all__}
    store = ConfigStore.instance()
    for group, choices in schemas.items():
        for name, schema in choices.items():
            store.store(group=f"schema/{group}", name=name, node=schema)


def schema_of(cls: type) -> type:
    """Return a dataclass with the arguments of a constructor as its fields, and `_target_`."""
    hints = get_type_hints(cls.__init__)  # type: ignore[misc]
    arguments = [
        (name, _field_type(hints[name]), MISSING if argument.default is Parameter.empty else argument.default)
        for name, argument in signature(cls).parameters.items()
        if argument.kind not in (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    ]
    return make_dataclass(cls.__name__, [("_target_", str, MISSING), *arguments])


def _field_type(annotation: Any) -> Any:
    """Return the type of a field: int, float, bool, str or an enumeration, perhaps optional; Any for everything else.

    For arguments that take an enumeration or the name of a member (`Gating | str`), it is the enumeration.
    """
    members = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    options = set(members) - {NoneType}
    enums = {option for option in options if isinstance(option, type) and issubclass(option, Enum)}
    if len(enums) == 1 and options <= enums | {str}:
        options = enums
    if len(options) != 1 or not enums | {int, float, bool, str} >= options:
        return Any
    (option,) = options
    return Optional[option] if NoneType in members else option  # noqa: UP045 (not a type until now)
