"""Types and ranges of the configuration: a dataclass per command, so that a wrong key or type stops a sweep before its first run.

The schemas of models are derived from their constructors; `register` makes all schemas known to Hydra.
"""

import math
import os
from collections.abc import Collection
from dataclasses import dataclass, field, make_dataclass
from enum import Enum
from functools import cache
from inspect import Parameter, signature
from ipaddress import ip_network
from types import NoneType, UnionType
from typing import Any, Optional, Union, get_args, get_origin, get_type_hints

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from cophy.dataset.experiment_set import FRAMES
from cophy.dataset.source import Source
from cophy.dataset.spec import Size
from cophy.dataset.splits import Split
from cophy.errors import check_name
from cophy.oracles.forecasts import ORACLES, OracleSettings
from cophy.released.states import ReleasedSource
from cophy.report.paper_tables import register_tables
from cophy.scenario import Balls, Blocktower, Collision, Scenario
from cophy.scenario.rendering import RenderSettings
from cophy.study.plan import Limits, StudySettings
from cophy.training.settings import Training


@dataclass
class OracleConfig(OracleSettings):
    """Arguments of `cophy.oracles.run.Oracle`; conf/model/ explains the numbers."""

    _target_: str = "cophy.oracles.run.Oracle"
    oracle: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_choice("model.oracle", self.oracle, ORACLES)


@dataclass
class TrainerConfig:
    """Arguments of lightning.Trainer that a run may set."""

    max_epochs: int = MISSING
    accelerator: str = MISSING
    devices: Any = MISSING  # a number, "auto" or a list of numbers; OmegaConf 2.3 cannot merge such unions
    precision: str = MISSING
    deterministic: bool = MISSING
    gradient_clip_val: float | None = None
    max_time: str | None = None
    check_val_every_n_epoch: int = 1
    limit_train_batches: Any = None  # a number of batches, or a share of them
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
        for key in ("limit_train_batches", "limit_test_batches"):
            if getattr(self, key) == 0:
                raise ValueError(f"trainer.{key}=0: at least one batch is needed")
        if self.max_epochs == 0 or self.max_epochs < -1:
            raise ValueError(f"trainer.max_epochs={self.max_epochs} must be positive, or -1 for no limit")
        _check_range("trainer.check_val_every_n_epoch", self.check_val_every_n_epoch, 1)
        _check_range("trainer.log_every_n_steps", self.log_every_n_steps, 1)

    def check_validates(self) -> None:
        """Refuse a training without validation; one that resumes from a checkpoint may have its best epoch from there.

        Raises:
            ValueError: No epoch is validated, or no batch of it.
        """
        every = self.check_val_every_n_epoch
        if self.max_epochs != -1 and every > self.max_epochs:
            raise ValueError(f"trainer.check_val_every_n_epoch={every} must be at most trainer.max_epochs")
        if self.limit_val_batches == 0:
            raise ValueError("trainer.limit_val_batches=0: at least one batch is needed")


MAX_SEED = 2**32 - 1  # of NumPy's global generator, which Lightning seeds
MAX_THREADS_PER_CORE = 8  # more only wait for each other

# positions= -> the splits in which a predictor sees estimated positions; in the others it sees true ones
ESTIMATED: dict[str, tuple[str, ...]] = {
    "ground_truth": (),
    "derendered": ("train", "val", "test"),
    "train_ground_truth_test_derendered": ("test",),  # the paper's headline setting
}

SCENARIOS: dict[str, type[Scenario]] = {"blocktower": Blocktower, "balls": Balls, "collision": Collision}


@dataclass
class DataConfig:
    """Keys of every command that reads data. num_objects: None for those that the split needs."""

    scenario: Scenario = MISSING
    split: Split = MISSING
    size: Size = MISSING
    num_objects: list[int] | None = None
    data_dir: str = MISSING
    data_seed: int = MISSING

    def __post_init__(self) -> None:
        _check_range("data_seed", self.data_seed, 0)
        _check_paths(self)
        if not isinstance(self.scenario, SCENARIOS.get(self.scenario.name, Scenario)):
            raise ValueError(f"scenario.name={self.scenario.name} is the name of another scenario")
        self.split.check_scenario(self.scenario)  # before slow imports


@dataclass
class MakeDataConfig(DataConfig):
    """Keys of every command that generates data. workers: processes."""

    workers: int = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_range("workers", self.workers, 1)


@dataclass
class RenderDataConfig(MakeDataConfig):
    """Keys of every command that renders data."""

    render: RenderSettings = MISSING


@dataclass
class PartConfig(MakeDataConfig):
    """Keys of every command that makes a part of the data.

    frames: those to render, or to de-render. part, parts: only every `parts`-th shard is made, from `part` on.
    """

    frames: str = MISSING
    part: int = MISSING
    parts: int = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_range("parts", self.parts, 1)
        _check_range("part", self.part, 0, self.parts - 1)
        _check_choice("frames", self.frames, FRAMES)


@dataclass
class GenerateConfig(PartConfig):
    """Keys of generate.py. seed: short for data_seed. model: an oracle whose forecasts are stored, or None."""

    seed: int = MISSING
    render: RenderSettings = MISSING
    model: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.model is None or isinstance(self.model, OracleConfig)):
            raise ValueError("model: only forecasts of oracles are stored with data (model=oracle_feedforward)")


@dataclass
class AuditConfig(DataConfig):
    """Keys of audit.py. replayed_pairs: twin pairs per dataset that are generated and simulated again."""

    source: Source = MISSING
    replayed_pairs: int = MISSING
    directory: str = MISSING
    seed: int = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_range("replayed_pairs", self.replayed_pairs, 1)


@dataclass
class LookConfig(RenderDataConfig):
    """Keys of look.py. experiment: the one shown over time. num_shown: experiments on the contact sheet."""

    experiment: int = MISSING
    num_shown: int = MISSING
    directory: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_range("num_shown", self.num_shown, 1)


EXPORT_FORMATS = ("cophy", "parquet", "archive")


@dataclass
class ExportConfig(DataConfig):
    """Keys of export.py. images: whether they are exported; None: only in the released format. root: output folder."""

    render: RenderSettings = MISSING
    format: str = MISSING
    images: bool | None = None
    root: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_choice("format", self.format, EXPORT_FORMATS)


@dataclass
class DerenderConfig(PartConfig):
    """Keys of derender.py. derenderer: a checkpoint; None for the one in `outputs` that fits."""

    source: Source = MISSING
    derenderer: str | None = None
    outputs: str = MISSING


@dataclass
class TrainConfig(RenderDataConfig):
    """Keys of train.py.

    seed: that of the training. render, num_images, num_objects: training data of a de-renderer. derenderer: checkpoint
    of the one whose estimates a predictor sees; None for the one in outputs/ that fits. model: keys of a schema, or
    any keys for a model of the user. logger, metrics: a `_target_` and its arguments each, by name.
    """

    source: Source = MISSING
    model: Any = MISSING
    training: Training = MISSING
    trainer: TrainerConfig = MISSING
    logger: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
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
        _check_range("seed", self.seed, 0, MAX_SEED)
        _check_range("threads", self.threads, 1, MAX_THREADS_PER_CORE * (os.cpu_count() or 1))
        _check_range("figures_every_n_epochs", self.figures_every_n_epochs, 1)
        _check_range("num_images", self.num_images, 10)
        for group in ("logger", "metrics"):
            for name, keys in getattr(self, group).items():
                if not isinstance(keys, dict):
                    raise ValueError(
                        f"{group}.{name} is no block with a _target_: its YAML starts with the line '# @package {group}.<name>'"
                    )
                check_name(group, name)
        if self.ckpt is not None and self.predictor is not None:
            raise ValueError("ckpt= resumes a training, predictor= replaces one: give one of them")
        if self.ckpt is None:
            self.trainer.check_validates()
        if not self.optimized_metric.startswith("val/"):
            raise ValueError(
                f"optimized_metric={self.optimized_metric} must be a metric of the validation split: val/mse, …"
            )
        _check_choice("positions", self.positions, ESTIMATED)


@dataclass
class ScoreConfig(DataConfig):
    """Keys of score.py; conf/score.yaml explains them."""

    predictions: str | None = None
    template: str | None = None
    name: str | None = None
    seed: int = MISSING
    positions: str = MISSING
    outputs: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_range("seed", self.seed, 0, MAX_SEED)
        _check_choice("positions", self.positions, ESTIMATED)
        if (self.predictions is None) == (self.template is None):
            raise ValueError("give predictions=, a file to score, or template=, a file to write with all ids")
        if self.num_objects is not None:
            raise ValueError("num_objects=: leave it out; split= sets the number of objects")
        if self.name is not None:
            check_name("name", self.name)


@dataclass
class PredictConfig:
    """Keys of predict.py; conf/predict.yaml explains them."""

    observed: str = MISSING
    initial: str = MISSING
    truth: str | None = None
    background: str | None = None
    derenderer: str = MISSING
    predictor: str = MISSING
    model_class: str | None = None
    directory: str = MISSING

    def __post_init__(self) -> None:
        _check_paths(self)


@dataclass
class ReportConfig:
    """Keys of report.py. source: that of the runs' data. outputs: where train.py wrote its runs. models, splits: only these.
    paper: whether to show the paper's tables; None for what runs fill of them. compare: only compare these methods.
    """

    source: Source = MISSING
    outputs: str = MISSING
    data_dir: str = MISSING
    directory: str = MISSING
    models: list[str] = field(default_factory=list)
    splits: list[str] = field(default_factory=list)
    paper: bool | None = None
    compare: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        _check_paths(self)


def _check_paths(config: Any) -> None:
    """Expand `~`, which shells leave alone inside of quotes."""
    folders = ("data_dir", "directory", "outputs", "root")
    files = (
        "ckpt",
        "predictor",
        "derenderer",
        "predictions",
        "template",
        "observed",
        "initial",
        "truth",
        "background",
        "welcome",
    )
    for key in (*folders, *files):
        if (path := getattr(config, key, None)) == "":
            raise ValueError(f"{key}= is empty: it names a {'folder' if key in folders else 'file'}")
        if path is not None:
            setattr(config, key, os.path.expanduser(path))


def _check_choice(key: str, value: str, choices: Collection[str]) -> None:
    if value not in choices:
        raise ValueError(f"{key}={value} is not among {', '.join(choices)}")


def _check_range(key: str, value: int, smallest: int, largest: float = math.inf) -> None:
    if not smallest <= value <= largest:
        limits = f"at least {smallest}" if largest == math.inf else f"from {smallest} to {largest}"
        raise ValueError(f"{key}={value} must be {limits}")


ACTIONS = ("serve", "export", "simulate", "power")


@dataclass
class StudyConfig(MakeDataConfig):
    """Keys of study.py; conf/study.yaml explains them."""

    action: str = MISSING
    participants: int = MISSING
    study: StudySettings = MISSING
    limits: Limits = MISSING
    directory: str = MISSING
    welcome: str | None = None
    host: str = MISSING
    port: int = MISSING
    allowed_hosts: list[str] = MISSING
    trusted_proxies: str = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_choice("action", self.action, ACTIONS)
        _check_range("participants", self.participants, 2)
        _check_range("port", self.port, 0, 65535)
        for address in self.trusted_proxies.replace("*", "").split(","):
            try:
                ip_network(address.strip() or "127.0.0.1")
            except ValueError as error:
                raise ValueError(f"trusted_proxies={self.trusted_proxies}: {error}") from error


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
        "score": ScoreConfig,
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
    # Hydra copies the whole store for each composition, and 184 times for --help: 5 s. What it loads from it is a copy anyway.
    store.__deepcopy__ = lambda memo: store  # type: ignore[attr-defined]
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
