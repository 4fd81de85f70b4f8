"""Everything a study needs, put together, and served."""

import errno
import math
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from filelock import FileLock, Timeout
from starlette.applications import Starlette

from cophy.dataset.splits import Split
from cophy.dataset.store.states import States
from cophy.errors import CophyError
from cophy.study.answer_store import AnswerStore
from cophy.study.experiments import StudyExperiments
from cophy.study.pages.browser_clips import Clips
from cophy.study.pages.server import WEB, make_app
from cophy.study.sessions import Sessions
from cophy.study.study_settings import SETTINGS, Limits, StudySettings

MAX_CONNECTIONS = 500
KEEP_ALIVE_S = 15
READING_S = 10  # ours: what a task takes beside the time to click: a clip of 6 s, and to go on


@dataclass(frozen=True)
class OpenStudy:
    """A study whose pictures are drawn and whose answers have their file."""

    sessions: Sessions
    experiments: StudyExperiments
    clips: Clips

    def app(self, welcome: str | None, limits: Limits) -> Starlette:
        """Its pages; welcome: Markdown of the first one, None for the package's. {seconds} and {minutes} are filled in."""
        text = (WEB / "text" / "welcome.md").read_text() if welcome is None else welcome
        settings = self.experiments.settings
        tasks = len(self.experiments.practice) + len(SETTINGS) * settings.num_assignments
        minutes = math.ceil(tasks * (settings.seconds + READING_S) / 60)
        text = text.replace("{seconds}", f"{settings.seconds:g}").replace("{minutes}", str(minutes))
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


def listening(host: str, port: int) -> socket.socket:
    """A socket that listens there.

    Raises:
        CophyError: Another program does, or the address is none, or none of this machine's.
    """
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except TypeError:
        raise CophyError(f"host={host}: this is no name of a host") from None
    except OSError as error:  # create_server says where it was met, too
        why = str(error.strerror or error).partition(" (while")[0]
        free = f"; port={port + 1} may be free" if error.errno == errno.EADDRINUSE else ""
        raise CophyError(f"host={host} port={port}: {why}{free}") from None


@contextmanager
def alone(answers: Path) -> Iterator[None]:
    """While one process writes a file of answers, no other does: each would count participants for itself.

    Raises:
        CophyError: Another does.
    """
    answers.parent.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(f"{answers}.lock", timeout=0):
            yield
    except Timeout:
        raise CophyError(f"{answers} is being written by another process: directory= names another folder") from None


def serve(app: Starlette, listener: socket.socket, trusted_proxies: str) -> None:
    """Until it is interrupted.

    Args:
        app: The pages.
        listener: See `listening`.
        trusted_proxies: Whose X-Forwarded-* headers are believed.
    """
    config = uvicorn.Config(
        app,
        forwarded_allow_ips=trusted_proxies,
        limit_concurrency=MAX_CONNECTIONS,
        timeout_keep_alive=KEEP_ALIVE_S,
        access_log=False,
        server_header=False,
        log_config=None,
    )
    with suppress(KeyboardInterrupt):  # it has shut down by then
        uvicorn.Server(config).run(sockets=[listener])
