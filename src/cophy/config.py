"""The datasets that a command's configuration names.

Configurations as the command line composes them, typed or not.
"""

import json
import math
from dataclasses import asdict, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import MissingConfigException
from omegaconf import DictConfig, OmegaConf

import cophy
from cophy.dataset.experiment_set import ExperimentSet
from cophy.dataset.source import generated_sets
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.schemas import AuditConfig, DataConfig, DerenderConfig, TrainConfig
from cophy.training.run import differences

OPEN = ("trainer.",)  # takes any argument of lightning.Trainer with +
PACKAGE = Path(cophy.__file__).parent
IN_WHEEL = PACKAGE / "conf"  # pyproject.toml puts it there
CONF = IN_WHEEL if IN_WHEEL.exists() else PACKAGE.parents[1] / "conf"

Config = TypeVar("Config")


def to_config(config: DictConfig, schema: type[Config]) -> Config:
    """The typed configuration, made of plain Python objects.

    Raises:
        CophyError: A value is out of its range or not resolved, or a key does not exist.
    """
    _check_keys(config, "")
    _check_finite(OmegaConf.to_container(config, resolve=False), "")
    try:
        built = OmegaConf.to_object(config)
    except (ValueError, TypeError) as error:
        raise CophyError(str(error)) from error
    assert isinstance(built, schema), type(built)
    return built


def _check_keys(config: DictConfig, path: str) -> None:
    """Refuse keys that were added with + and that nothing reads; those of a model of one's own are free."""
    schema = OmegaConf.get_type(config)
    if path in OPEN or not is_dataclass(schema):
        return
    wanted = get_type_hints(schema)
    for key in map(str, config):
        if key not in wanted:
            raise CophyError(f"{path}{key}: there is no such key; --help lists them")
        if OmegaConf.is_missing(config, key):
            continue
        _check_container(config[key], wanted[key], f"{path}{key}")
        if isinstance(child := config[key], DictConfig):
            _check_keys(child, f"{path}{key}.")


def _check_container(value: Any, wanted: Any, path: str) -> None:
    """Refuse what is no list or dict where one belongs: OmegaConf lets a reference (`${key}`) be anything."""
    kind = get_origin(wanted)
    if kind not in (list, dict):
        return
    if not (OmegaConf.is_list(value) if kind is list else OmegaConf.is_dict(value)):
        raise CophyError(f"{path}={value}: here is a {wanted}")
    for inner in value if kind is list else value.values():
        _check_container(inner, get_args(wanted)[-1], path)


def _check_finite(value: Any, path: str) -> None:
    """Refuse NaN, infinite numbers and those of more than 64 bits, of which no key makes sense."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            _check_finite(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, float) and not math.isfinite(value):
        raise CophyError(f"{path}={value} must be a finite number")
    elif isinstance(value, int) and value.bit_length() > 63:
        raise CophyError(f"{path} is a number of {value.bit_length()} bits: too large")


def to_plain(config: DictConfig) -> dict[str, Any]:
    """The configuration as dicts, lists and values, all references resolved and enumerations by name."""
    plain = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    assert isinstance(plain, dict)
    return {str(key): value for key, value in plain.items()}


def composed(name: str, *overrides: str, return_hydra_config: bool = False) -> DictConfig:
    """What `python src/<name>.py <overrides>` composes.

    Inside a command, the folders of configurations that the command was given count too. A Hydra program of somebody else's
    that calls this is left as it is.

    Args:
        name: Of the command.
        overrides: Of its configuration.
        return_hydra_config: Whether Hydra's own keys are in it.
    """
    if _is_in_a_command():
        given = HydraConfig.get().overrides.hydra
        return hydra.compose(
            name, [*(path for path in given if path.startswith("hydra.searchpath=")), *overrides], return_hydra_config
        )
    instance = GlobalHydra.instance()
    before, instance.hydra = instance.hydra, None
    try:
        with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
            return hydra.compose(name, list(overrides), return_hydra_config)
    finally:
        GlobalHydra.instance().hydra = before


def _is_in_a_command() -> bool:
    """Whether Hydra is at work for a command of ours."""
    if not (GlobalHydra.instance().is_initialized() and HydraConfig.initialized()):
        return False
    return any(Path(source.path) == CONF for source in HydraConfig.get().runtime.config_sources)


def settings(name: str, *overrides: str) -> Any:
    """The same, typed: an object of the schema of that command."""
    return to_config(composed(name, *overrides), object)


def generated_by(settings: DataConfig) -> list[States]:
    """The generated datasets that the split, or num_objects, names."""
    return generated_sets(
        settings.scenario,
        settings.split,
        settings.num_objects,
        size=settings.size,
        data_seed=settings.data_seed,
        data_dir=Path(settings.data_dir),
        overrides=_overrides(settings),
    )


def experiments_of(
    settings: AuditConfig | DerenderConfig | TrainConfig, num_objects: list[int] | None
) -> list[ExperimentSet]:
    """The datasets of the configured source, generated or released, that the split or `num_objects` names."""
    return settings.source.experiment_sets(
        settings.scenario,
        settings.split,
        num_objects,
        size=settings.size,
        data_seed=settings.data_seed,
        data_dir=Path(settings.data_dir),
        overrides=_overrides(settings) if settings.source.is_generated else (),
    )


def _overrides(settings: DataConfig) -> tuple[str, ...]:
    """What scenario and size change beyond their names, as `DatasetSpec.overrides`."""
    sources = str(HydraConfig.get().runtime.config_sources) if HydraConfig.initialized() else ""
    usual = _usual(settings.scenario.name, settings.size.name, sources)
    own = {"scenario": asdict(settings.scenario), "size": asdict(settings.size)}
    changed = [pair for key, value in own.items() if key in usual for pair in differences(key, value, usual[key])]
    return tuple(f"++{key}={json.dumps(value, separators=(',', ':'))}" for key, value in changed)


@cache
def _usual(scenario: str, size: str, sources: str) -> dict[str, Any]:
    """Scenario and size as these names say; nothing where one of them is a name in no file.

    Args:
        scenario: The choice of its group.
        size: Likewise.
        sources: The folders of configurations that the command was given, for the cache.
    """
    try:
        config = settings("generate", f"scenario={scenario}", f"size={size}")
    except MissingConfigException:
        return {}
    return {"scenario": asdict(config.scenario), "size": asdict(config.size)}
