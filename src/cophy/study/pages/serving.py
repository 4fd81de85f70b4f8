"""Everything a study needs, put together, and served."""

from dataclasses import dataclass
from pathlib import Path

import uvicorn
from starlette.applications import Starlette

from cophy.dataset.splits import Split
from cophy.dataset.store.states import States
from cophy.study.answer_store import AnswerStore
from cophy.study.experiments import StudyExperiments
from cophy.study.pages.browser_clips import Clips
from cophy.study.pages.server import WEB, make_app
from cophy.study.sessions import Sessions
from cophy.study.study_settings import Limits, StudySettings

MAX_CONNECTIONS = 500
KEEP_ALIVE_S = 15


@dataclass(frozen=True)
class OpenStudy:
    """A study whose pictures are drawn and whose answers have their file."""

    sessions: Sessions
    experiments: StudyExperiments
    clips: Clips

    def app(self, welcome: Path | None, limits: Limits) -> Starlette:
        """Its pages; welcome: Markdown of the first one, None for the package's."""
        text = (welcome or WEB / "text" / "welcome.md").read_text()
        return make_app(self.sessions, self.experiments, self.clips, welcome=text, limits=limits)


def open_study(
    store: AnswerStore,
    states: States,
    split: Split,
    settings: StudySettings,
    directory: Path,
    *,
    kind: str,
    workers: int,
) -> OpenStudy:
    """Choose the experiments, draw what is missing of them.

    Args:
        store: Where answers go.
        states: The data, generated.
        split: Whose test half is shown.
        settings: Of the study.
        directory: Where pictures are kept.
        kind: Of the participants.
        workers: Processes that draw.
    """
    experiments = StudyExperiments(states, split, settings)
    clips = Clips(directory, experiments)
    clips.ensure(workers=workers)
    sessions = Sessions(
        store,
        settings,
        study=experiments.study_id,
        kind=kind,
        description=experiments.description,
        practice=experiments.practice,
        plan=experiments.plan,
        slots_of=experiments.scenes.slots,
    )
    return OpenStudy(sessions, experiments, clips)


def serve(app: Starlette, host: str, port: int, trusted_proxies: str) -> None:
    """Until it is interrupted.

    Args:
        app: The pages.
        host: Address to listen on.
        port: Likewise.
        trusted_proxies: Whose X-Forwarded-* headers are believed.
    """
    uvicorn.run(
        app,
        host=host,
        port=port,
        forwarded_allow_ips=trusted_proxies,
        limit_concurrency=MAX_CONNECTIONS,
        timeout_keep_alive=KEEP_ALIVE_S,
        access_log=False,
        server_header=False,
        log_config=None,
    )
