"""Makes the schemas known to Hydra.

They live in groups of their own (`schema/...`), so that `glob(*)` over scenarios or models finds choices only.
"""

from hydra.core.config_store import ConfigStore

from cophy.app.schemas.commands import (
    SCENARIOS,
    AuditConfig,
    DerenderConfig,
    ExportConfig,
    GenerateConfig,
    LookConfig,
    PredictConfig,
    ReportConfig,
    TrainConfig,
)
from cophy.app.schemas.models import (
    AlongsideConfig,
    CoPhyNetConfig,
    CopyBConfig,
    CopyCConfig,
    DerendererConfig,
    InteractionNetworkConfig,
    OracleConfig,
)
from cophy.app.schemas.study_command import StudyConfig
from cophy.dataset.source import Source
from cophy.dataset.spec import Size
from cophy.dataset.splits import Split
from cophy.scenario.rendering.frames import RenderSettings

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
    "source": {"source": Source},
    "render": {"render": RenderSettings},
    "model": {
        "cophynet": CoPhyNetConfig,
        "alongside": AlongsideConfig,
        "interaction_network": InteractionNetworkConfig,
        "derenderer": DerendererConfig,
        "oracle": OracleConfig,
        "copy_c": CopyCConfig,
        "copy_b": CopyBConfig,
    },
}


def register() -> None:
    """Make the schemas known to Hydra, as `schema/<group>/<name>`."""
    store = ConfigStore.instance()
    for group, schemas in SCHEMAS.items():
        for name, schema in schemas.items():
            store.store(group=f"schema/{group}", name=name, node=schema)
