"""Everything a study needs, put together, and served.

What every answer of the server carries, and what no browser may exceed.
The pages of a study and their addresses. Of experiments, only what the participant's own place allows is ever sent.
"""

import errno
import json
import logging
import math
import re
import socket
import sqlite3
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from anyio.to_thread import run_sync
from filelock import FileLock, Timeout
from markdown_it import MarkdownIt
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cophy.dataset.splits import Split
from cophy.dataset.states import States
from cophy.errors import CophyError
from cophy.study.answers import AnswerStore, BadAnswerError
from cophy.study.clips import CLIP, PICTURE, Clips
from cophy.study.experiments import StudyExperiments
from cophy.study.sessions import Place, RefusedError, Sessions
from cophy.study.settings import SETTINGS, Limits, StudySettings

log = logging.getLogger(__name__)

MAX_BODY_BYTES = 4096  # an answer on nine objects has about 700
MAX_PATH_BYTES = 512
BURST_S = 5.0  # so many seconds' worth of requests may come at once
MAX_ADDRESSES = 10_000  # that rates are remembered of
# styles in attributes: the bar of jsPsych's preloading; scripts only from our own files
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; style-src-attr 'unsafe-inline'; img-src 'self' blob: data:; "
    "media-src 'self' blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
    "Cache-Control": "no-store",
}
FAILED = "This did not work on the server. Please load this page again in a minute."


class Rate:
    """So many requests per second from one address, and so many at once after a pause."""

    def __init__(self, per_second: float, at_once: float) -> None:
        self._per_second, self._at_once = per_second, at_once
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()  # address -> requests left, when

    def allows(self, address: str) -> bool:
        """Whether one more may come now; it counts."""
        now, most = time.monotonic(), self._at_once
        left, before = self._left.pop(address, (most, now))
        left = min(most, left + (now - before) * self._per_second)
        self._left[address] = (left - 1 if left >= 1 else left, now)
        if len(self._left) > MAX_ADDRESSES:
            self._left.popitem(last=False)
        return left >= 1


class Guards:
    """ASGI middleware: limits first, then the page, with its headers; where the page fails, JSON that says so."""

    def __init__(self, app: ASGIApp, requests_per_second: float) -> None:
        self._app, self._rate = app, Rate(requests_per_second, BURST_S * requests_per_second)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        begun = False

        async def with_headers(message: Message) -> None:
            nonlocal begun
            if message["type"] == "http.response.start":
                begun = True
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
            await send(message)

        address = scope["client"][0] if scope.get("client") else ""
        if not self._rate.allows(address):
            await JSONResponse({"error": "Too many requests."}, 429)(scope, receive, with_headers)
        elif len(scope.get("raw_path", b"")) + len(scope["query_string"]) > MAX_PATH_BYTES:
            await JSONResponse({"error": "The address is too long."}, 414)(scope, receive, with_headers)
        else:
            try:
                await self._app(scope, receive, with_headers)
            except Exception as error:
                if begun:
                    raise
                await JSONResponse({"error": FAILED}, _logged(scope, error))(scope, receive, with_headers)


def _logged(scope: Scope, error: Exception) -> int:
    """The status of HTTP of an error, which is told to the person at the terminal alone."""
    if isinstance(error, sqlite3.Error):  # a full disk, a file that somebody locks
        log.error("%s %r: the file of answers: %s", scope["method"], scope["path"], error)
        return 503
    log.error("%s %r", scope["method"], scope["path"], exc_info=error)
    return 500


async def json_of(request: Request) -> Any:
    """The body of a request of our own pages, decoded.

    Raises:
        RefusedError: it is too large, no JSON, or comes from another site.
    """
    origin = request.headers.get("origin")
    if origin is not None and not _is_of(request.headers.get("host"), origin):
        raise RefusedError(403, "This request comes from another site.")
    if request.headers.get("content-type", "").split(";")[0] != "application/json":
        raise RefusedError(415, "This is no JSON.")
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > MAX_BODY_BYTES:
            raise RefusedError(413, "This is too large.")
    try:
        return json.loads(body, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise RefusedError(400, "This is no JSON.") from error


def _is_of(host: str | None, origin: str) -> bool:
    try:
        return urlsplit(origin).netloc == host
    except ValueError:  # no address
        return False


def _refuse_constant(name: str) -> Any:
    raise ValueError(name)


WEB = Path(__file__).parent / "web"
COOKIE = "cophy_study"
COOKIE_AGE_S = 7 * 24 * 3600
MAX_PLATFORM_ID = 128  # letters
SURROGATE = re.compile("[\ud800-\udfff]")
CONSENT = {"agreed", "platform_id", "token"}
TOKEN = re.compile(r"[A-Za-z0-9_-]{43}")  # 32 bytes in Base64
KINDS = {"picture": (PICTURE, "image/png"), "clip": (CLIP, "video/webm")}


def make_app(
    sessions: Sessions, experiments: StudyExperiments, clips: Clips, *, welcome: str, limits: Limits
) -> Starlette:
    """The study as an ASGI application.

    Args:
        sessions: Of its participants.
        experiments: That they are asked about.
        clips: Drawn before.
        welcome: Text of the first page, Markdown; HTML in it is shown as text.
        limits: Of one address.
    """
    pages = _Pages(sessions, experiments, clips, welcome, limits)
    routes = [
        Route("/", pages.index),
        Route("/api/welcome", pages.welcome),
        Route("/api/consent", pages.consent, methods=["POST"]),
        Route("/api/place", pages.place),
        Route("/api/assignments/{position:int}/begin", pages.begin, methods=["POST"]),
        Route("/api/assignments/{position:int}/answer", pages.answer, methods=["POST"]),
        Route("/media/{position:int}/{kind}", pages.media),
        Mount("/web", StaticFiles(directory=WEB)),
    ]
    handlers: dict[Any, Any] = {RefusedError: _refused, BadAnswerError: _bad}
    guards = Middleware(Guards, requests_per_second=limits.requests_per_second)
    return Starlette(routes=routes, exception_handlers=handlers, middleware=[guards])


class _Pages:
    def __init__(
        self, sessions: Sessions, experiments: StudyExperiments, clips: Clips, welcome: str, limits: Limits
    ) -> None:
        self._sessions, self._experiments, self._clips = sessions, experiments, clips
        self._welcome = MarkdownIt("commonmark", {"html": False}).render(welcome)
        self._consents = Rate(limits.people_per_minute / 60, limits.people_per_minute)

    async def index(self, request: Request) -> Response:
        return FileResponse(WEB / "index.html")

    async def welcome(self, request: Request) -> Response:
        return JSONResponse({"html": self._welcome})

    async def consent(self, request: Request) -> Response:
        body = await json_of(request)
        if not isinstance(body, dict) or body.get("agreed") is not True or set(body) - CONSENT:
            raise RefusedError(400, "Nothing begins without consent.")
        platform_id, drawn = _checked_id(body.get("platform_id")), body.get("token")
        if drawn is not None and not (isinstance(drawn, str) and TOKEN.fullmatch(drawn)):
            raise RefusedError(400, "This is no token of 32 bytes.")
        try:
            before = await run_sync(self._sessions.place, request.cookies.get(COOKIE), platform_id)
            return JSONResponse(self._said(before))
        except RefusedError:  # nobody with this token yet
            if request.client is not None and not self._consents.allows(request.client.host):
                raise RefusedError(
                    429, "Too many people begin from this address. Please try again in a minute."
                ) from None
        token = await run_sync(self._sessions.consent, platform_id, drawn)
        response = JSONResponse(self._said(await run_sync(self._sessions.place, token)))
        secure = request.url.scheme == "https"
        response.set_cookie(COOKIE, token, COOKIE_AGE_S, httponly=True, samesite="strict", secure=secure)
        return response

    async def place(self, request: Request) -> Response:
        platform_id = _checked_id(request.query_params.get("platform_id"))
        found = await run_sync(self._sessions.place, request.cookies.get(COOKIE), platform_id)
        return JSONResponse(self._said(found))

    async def begin(self, request: Request) -> Response:
        await json_of(request)
        place = await run_sync(self._sessions.begin, request.cookies.get(COOKIE), request.path_params["position"])
        return JSONResponse(self._said(place))

    async def answer(self, request: Request) -> Response:
        body, position = await json_of(request), request.path_params["position"]
        store: Callable[[], Any] = partial(self._sessions.answer, request.cookies.get(COOKIE), position, body)
        assignment, is_practice = await run_sync(store)
        ends = self._experiments.scenes.ends(assignment.experiment) if is_practice else None
        return JSONResponse({"stored": True, **({} if ends is None else {"ends": ends})})

    async def media(self, request: Request) -> Response:
        """Of the participant's current assignment alone."""
        kind, position = request.path_params["kind"], request.path_params["position"]
        place = await run_sync(self._sessions.place, request.cookies.get(COOKIE))
        assignment = place.assignment
        wanted = assignment is not None and position == place.position and kind in KINDS
        if assignment is None or not wanted or (kind == "clip" and assignment.setting != "cf"):
            raise RefusedError(404, "There is no such picture.")
        file, media_type = KINDS[kind]
        content = await run_sync(self._clips.path(assignment.experiment, file).read_bytes)
        return Response(content, media_type=media_type)

    def _said(self, place: Place) -> dict[str, Any]:
        """What a browser is told of a place."""
        num_practice, settings = len(self._sessions.practice), self._sessions.settings
        told: dict[str, Any] = {
            "position": place.position,
            "num_practice": num_practice,
            "num_positions": self._sessions.num_positions,
        }
        if place.assignment is None:
            return told | {"code": place.code}
        has_clip = place.assignment.setting == "cf"
        return told | {
            "is_practice": place.position < num_practice,
            "seconds": settings.seconds,
            "remaining_s": place.remaining_s,
            "resolution": settings.resolution,
            "objects": self._experiments.scenes.objects(place.assignment.experiment),
            "picture": f"/media/{place.position}/picture",
            "clip": f"/media/{place.position}/clip" if has_clip else None,
        }


def _checked_id(value: Any) -> str | None:
    """None, or text of some letters; JSON may hold halves of letters, which no address does.

    Raises:
        RefusedError: It is neither.
    """
    if value is None:
        return None
    if not isinstance(value, str) or not 1 <= len(value) <= MAX_PLATFORM_ID or SURROGATE.search(value):
        raise RefusedError(400, "This is no id of a platform.")
    return value


async def _refused(request: Request, error: RefusedError) -> Response:
    return JSONResponse({"error": error.reason}, error.status)


async def _bad(request: Request, error: BadAnswerError) -> Response:
    return JSONResponse({"error": f"This is no answer: {error}."}, 422)


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
