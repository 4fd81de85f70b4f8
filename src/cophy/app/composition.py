"""Configurations as the command line composes them, typed or not."""

from pathlib import Path
from typing import Any, TypeVar

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

import cophy
from cophy.errors import CophyError

CONF = Path(cophy.__file__).parents[2] / "conf"

Config = TypeVar("Config")


def to_config(config: DictConfig, schema: type[Config]) -> Config:
    """The typed configuration, made of plain Python objects.

    Raises:
        CophyError: A value is out of its range, or not resolved.
    """
    try:
        built = OmegaConf.to_object(config)
    except (ValueError, TypeError) as error:
        raise CophyError(str(error)) from error
    assert isinstance(built, schema), type(built)
    return built


def to_plain(config: DictConfig) -> dict[str, Any]:
    """The configuration as dicts, lists and values, all references resolved and enumerations by name."""
    plain = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    assert isinstance(plain, dict)
    return {str(key): value for key, value in plain.items()}


def composed(name: str, *overrides: str) -> DictConfig:
    """What `python src/<name>.py <overrides>` composes.

    Inside a command, the folders of configurations that the command was given count too.
    """
    if GlobalHydra.instance().is_initialized():
        given = HydraConfig.get().overrides.hydra
        return hydra.compose(name, [*(path for path in given if path.startswith("hydra.searchpath=")), *overrides])
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        return hydra.compose(name, list(overrides))


def settings(name: str, *overrides: str) -> Any:
    """The same, typed: an object of the schema of that command."""
    return to_config(composed(name, *overrides), object)
