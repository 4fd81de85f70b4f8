"""The datasets that a command's configuration names."""

import json
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.errors import MissingConfigException

from cophy.app.composition import settings as composed_settings
from cophy.app.schemas.commands import AuditConfig, DataConfig, DerenderConfig, TrainConfig
from cophy.dataset.source import generated_sets
from cophy.dataset.store.experiment_set import ExperimentSet
from cophy.dataset.store.states import States
from cophy.training.runs.identity import differences


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
        config = composed_settings("generate", f"scenario={scenario}", f"size={size}")
    except MissingConfigException:
        return {}
    return {"scenario": asdict(config.scenario), "size": asdict(config.size)}
