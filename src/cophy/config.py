"""Compose configurations, make them typed objects, and name what a run changes beyond its names.

The names of a run (scenario, split, model, ablation, positions, seed) are parts of its directory. `variant` is the rest, the
end of the directory's name: `seed0+size-12k+hidden_dim-8`.
"""

import functools
import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import hydra
from hydra.conf import HydraConf
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import MissingConfigException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import cophy
from cophy.dataset.experiment_set import ExperimentSet
from cophy.dataset.spec import DatasetSpec
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.released.states import ReleasedSource
from cophy.schemas import SCENARIOS, AuditConfig, DataConfig, DerenderConfig, TrainConfig, register
from cophy.training.run import differences, plain_value, short_keys

OPEN = ("trainer.",)  # takes any argument of lightning.Trainer with +
_PACKAGE = Path(cophy.__file__).parent
_IN_WHEEL = _PACKAGE / "conf"  # pyproject.toml puts it there
CONF = _IN_WHEEL if _IN_WHEEL.exists() else _PACKAGE.parents[1] / "conf"

FOLDERS = {"COPHY_DATA": "data", "COPHY_OUTPUTS": "outputs"}  # environment variable -> the folder where it is not set

ConfigT = TypeVar("ConfigT")


def folder(variable: str) -> str:
    """Return the folder that one of `FOLDERS` names: the default of data_dir, or that of the outputs of all commands."""
    return os.path.expanduser(os.environ.get(variable) or FOLDERS[variable])


def to_config(config: DictConfig, schema: type[ConfigT]) -> ConfigT:
    """Return the typed configuration, made of plain Python objects.

    Raises:
        CophyError: A value is out of its range, or a key does not exist.
    """
    _check_keys(config, "")
    try:
        result = OmegaConf.to_object(config)
    except ValueError as error:  # raised by the __post_init__ of a schema
        if isinstance(error, OmegaConfBaseException):
            raise
        raise CophyError(str(error)) from error
    assert isinstance(result, schema), type(result)
    return result


def _check_keys(config: DictConfig, path: str) -> None:
    """Refuse unknown keys that were added with +; a model without a schema takes any."""
    schema = OmegaConf.get_type(config)
    if path in OPEN or not is_dataclass(schema):
        return
    known = get_type_hints(schema)
    for key in map(str, config):
        if key not in known:
            raise CophyError(f"{path}{key}: there is no such key; --help lists them")
        if not OmegaConf.is_missing(config, key) and isinstance(child := config[key], DictConfig):
            _check_keys(child, f"{path}{key}.")


def to_plain(config: DictConfig) -> dict[str, Any]:
    """Return the configuration as dicts, lists and values, with all references resolved and enumerations by name."""
    plain = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    assert isinstance(plain, dict)
    return {str(key): value for key, value in plain.items()}


def composed(name: str, *overrides: str, return_hydra_config: bool = False) -> DictConfig:
    """Return what `python src/<name>.py <overrides>` composes.

    Inside a command, its search path of configurations is used. Somebody else's Hydra program that calls this keeps its own.
    """
    if _is_in_a_command():
        hydra_overrides = HydraConfig.get().overrides.hydra
        search_path = [override for override in hydra_overrides if override.startswith("hydra.searchpath=")]
        return hydra.compose(name, [*search_path, *overrides], return_hydra_config)
    register(models=name == "train")
    instance = GlobalHydra.instance()
    before, instance.hydra = instance.hydra, None
    try:
        with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
            return hydra.compose(name, list(overrides), return_hydra_config)
    finally:
        GlobalHydra.instance().hydra = before


def _is_in_a_command() -> bool:
    """Return whether Hydra runs one of our commands."""
    if not (GlobalHydra.instance().is_initialized() and HydraConfig.initialized()):
        return False
    return any(Path(source.path) == CONF for source in HydraConfig.get().runtime.config_sources)


def require_scenario() -> None:
    """Raise CophyError if the command line names no scenario, for commands to which the default one tells nothing."""
    if "scenario" not in map(_key_of, HydraConfig.get().overrides.task):
        raise CophyError(f"scenario= is not given: choose among {', '.join(SCENARIOS)}")


def settings(name: str, *overrides: str) -> Any:
    """Return what `python src/<name>.py <overrides>` composes, as an object of the command's schema."""
    return to_config(composed(name, *overrides), object)


# The datasets of a configuration


def generated_by(config: DataConfig) -> list[States]:
    """Return the generated datasets that the split, or num_objects, names."""
    overrides, counts = _data_overrides(config), config.split.counts(config.num_objects)
    specs = [DatasetSpec(config.scenario, count, config.size, config.data_seed, overrides) for count in counts]
    return [States(spec, Path(config.data_dir)) for spec in specs]


def experiments_of(
    config: AuditConfig | DerenderConfig | TrainConfig, num_objects: list[int] | None
) -> list[ExperimentSet]:
    """Return the datasets of the configured source, generated or released, that the split or `num_objects` names."""
    if isinstance(config.source, ReleasedSource):
        data_dir = Path(config.data_dir)
        return [*config.source.experiment_sets(config.scenario, config.split, num_objects, data_dir)]
    return [*generated_by(replace(config, num_objects=num_objects))]


def _data_overrides(config: DataConfig) -> tuple[str, ...]:
    """Return what scenario and size change beyond their names, as `DatasetSpec.overrides`."""
    sources = str(HydraConfig.get().runtime.config_sources) if HydraConfig.initialized() else ""
    expected = _compose_data(config.scenario.name, config.size.name, sources)
    actual = {"scenario": asdict(config.scenario), "size": asdict(config.size)}
    changed = [pair for key in expected for pair in differences(key, actual[key], expected[key])]
    return tuple(f"++{key}={json.dumps(value, separators=(',', ':'))}" for key, value in changed)


@functools.cache
def _compose_data(scenario: str, size: str, sources: str) -> dict[str, Any]:
    """Return scenario and size as their names compose them, or nothing if there is no file of such a name.

    Args:
        sources: The search path of configurations, as part of the cache's key.
    """
    try:
        config = settings("generate", f"scenario='{scenario}'", f"size='{size}'")
    except MissingConfigException:
        return {}
    return {"scenario": asdict(config.scenario), "size": asdict(config.size)}


# The variant of a run

PATH_GROUPS = ("scenario", "split", "model", "ablation", "source")  # groups whose choices are parts of the path
CHOICES = ("size", "confounders", "trainer", "loss", "optimizer", "schedule")  # the choice is shorter than its keys
COMPARED = ("size", "data_seed", "scenario", "split", "model", "training", "trainer", "derenderer", "source.splits")
COMPARED_FOR_DERENDERERS = ("render", "num_images", "num_objects")
LONGEST = 100  # characters; file systems allow 255
# keys that change no variant: they have no effect on results, or are themselves parts of the path
IGNORED = {field.name for field in fields(TrainConfig)} - {
    key.partition(".")[0] for key in (*COMPARED, *COMPARED_FOR_DERENDERERS)
}


def changes(config: DictConfig, hydra_config: HydraConf) -> dict[str, Any]:
    """Return what a run changes beyond its names, key -> value: choices of groups first, then keys in alphabetical order.

    Args:
        hydra_config: What Hydra says of it: the choices of groups, and the overrides of the command line.
    """
    keys = {_key_of(override) for override in hydra_config.overrides.task} - {*PATH_GROUPS}
    if {key.partition(".")[0] for key in keys} <= IGNORED:
        return {}
    choices, sources = hydra_config.runtime.choices, str(hydra_config.runtime.config_sources)
    names = [f"{group}='{choices[group]}'" for group in PATH_GROUPS]  # quoted: a name may look like a number
    expected = _compose_choices(sources, *names)
    groups = [group for group in CHOICES if choices.get(group) != expected.hydra.runtime.choices.get(group)]
    if groups:
        expected = _compose_choices(sources, *names, *(f"{group}='{choices[group]}'" for group in groups))
    is_derenderer = str(choices["model"]).startswith("derenderer")
    changed = {
        key: value
        for root in (*COMPARED, *(COMPARED_FOR_DERENDERERS if is_derenderer else ()))
        for key, value in differences(root, plain_value(config, root), plain_value(expected, root))
        if not (_is_reference(config, key) and _is_reference(expected, key))
    }
    return {group: choices[group] for group in groups} | dict(sorted(changed.items()))


def variant(changed: Mapping[str, Any]) -> str:
    """Return what a run changes beyond its names (see `changes`) as part of its directory's name, "" for nothing.

    Equal configurations have the same variant, in whatever order their keys are written. It has no `=` and `,`, because a path
    with these would need quotes twice as the value of a key (`ckpt=`, `derenderer=`).

    Returns:
        For example "+confounders-released+hidden_dim-8"; if that is long, its beginning and a hash of all.
    """
    short = short_keys(key for key in changed if key not in CHOICES)
    text = "+".join(f"{short.get(key, key)}-{_to_path(value)}" for key, value in changed.items())
    if len(text) > LONGEST:
        text = f"{text[: LONGEST - 9]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return f"+{text}" if text else ""


def _key_of(override: str) -> str:
    """Return the key or group of an override: `model.hidden_dim` of `++model.hidden_dim=8`."""
    return override.partition("=")[0].lstrip("+~").partition("@")[0]


@functools.cache
def _compose_choices(sources: str, *choices: str) -> DictConfig:
    """Return what these choices of groups compose; `sources` is the search path, for the cache. Do not change the result."""
    return composed("train", *choices, return_hydra_config=True)


def _is_reference(config: DictConfig, key: str) -> bool:
    """Return whether a key only repeats another one, as training.optimizer.lr does."""
    parent, _, name = key.rpartition(".")
    node = OmegaConf.select(config, parent) if parent else config
    return isinstance(node, DictConfig) and name in node and OmegaConf.is_interpolation(node, name)


def value_text(value: Any) -> str:
    """Return a value as text; for a value with keys of its own, a hash."""
    if isinstance(value, dict):
        return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:6]
    return str(value)


def _to_path(value: Any) -> str:
    """Return a value as part of a directory's name."""
    return re.sub(r"[^\w.-]+", "_", value_text(value)).strip("_")


def _resolve_variant(*, _root_: DictConfig) -> str:
    """Return `${variant:}`, which conf/train.yaml puts into the directory of a run."""
    return variant(changes(_root_, _root_.hydra))


def _resolve_outputs(*, _root_: DictConfig) -> str:
    """Return `${outputs:}`, source.outputs as the folder above all runs: an empty name would be the root of the file system."""
    if not _root_.source.outputs:
        raise CophyError("source.outputs= is empty: it names a folder")
    return os.path.expanduser(_root_.source.outputs)


# at import, because processes of Hydra's launchers import this module and call no function of it before they need it
OmegaConf.register_new_resolver("variant", _resolve_variant, replace=True)
OmegaConf.register_new_resolver("outputs", _resolve_outputs, replace=True)
OmegaConf.register_new_resolver("folder", folder, replace=True)
