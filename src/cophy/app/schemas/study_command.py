"""The types and ranges of the keys of study.py."""

from dataclasses import dataclass

from omegaconf import MISSING

from cophy.app.schemas.commands import MakeDataConfig
from cophy.study.study_settings import Limits, StudySettings

ACTIONS = ("serve", "export", "simulate", "power")


@dataclass
class StudyConfig(MakeDataConfig):
    """study.py. action: what is done with the study. participants: simulated ones of each kind. welcome: Markdown file of the first page, None for the package's."""

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
