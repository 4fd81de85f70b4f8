"""The datasets that a command's configuration names."""

from pathlib import Path

from cophy.app.schemas.commands import AuditConfig, DataConfig, DerenderConfig, TrainConfig
from cophy.dataset.source import generated_sets
from cophy.dataset.store.experiment_set import ExperimentSet
from cophy.dataset.store.states import States


def generated_by(settings: DataConfig) -> list[States]:
    """The generated datasets that the split, or num_objects, names."""
    return generated_sets(
        settings.scenario,
        settings.split,
        settings.num_objects,
        size=settings.size,
        data_seed=settings.data_seed,
        data_dir=Path(settings.data_dir),
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
    )
