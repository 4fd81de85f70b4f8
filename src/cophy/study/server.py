"""The web server of a study: its pages, its JSON interface, and limits for requests from anywhere.

Of the experiments, it sends only what the participant's current task shows.
"""

import asyncio
import errno
import ipaddress
import json
import logging
import math
import re
import socket
import sqlite3
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Collection
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from anyio.to_thread import run_sync
from markdown_it import MarkdownIt
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from uvicorn.protocols.http.h11_impl import H11Protocol

from cophy.errors import CophyError
from cophy.study.answers import RefusedError
from cophy.study.experiments import CLIP, IMAGE
from cophy.study.plan import SETTINGS, Limits, StudySettings
from cophy.study.sessions import Place, Sessions

log = logging.getLogger(__name__)

MAX_CONNECTIONS = 500
KEEP_ALIVE_S = 15
REQUEST_S = 60  # ours: time for a request to begin, and then to be answered; a database in use fails after 30 s
MAX_BODY_BYTES = 4096  # an answer about nine objects has about 700
MAX_ADDRESSES = 10_000  # whose rates are remembered
BURST_S = 5.0  # requests of so many seconds may arrive at once
# styles in attributes: the progress bar of jsPsych's preloading; scripts only from our own files
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "style-src-attr 'unsafe-inline'; img-src 'self' blob: data:; media-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
FAILED = "This did not work on the server. Please load this page again in a minute."
WEB = Path(__file__).parent / "web"
COOKIE = "cophy_study"
COOKIE_AGE_S = 7 * 24 * 3600
MAX_PLATFORM_ID = 128  # characters
TOKEN = re.compile(r"[A-Za-z0-9_-]{43}")  # 32 bytes in Base64
MEDIA = {"picture": (IMAGE, "image/png"), "clip": (CLIP, "video/webm")}  # last part of the URL -> file and its type
READING_S = 10  # ours: time of a task besides the clicks: a clip of 6 s, and the way to the next task


class Rate:
    """Limit of requests per second from one address, with a burst after a pause."""

    def __init__(self, per_second: float, burst: float) -> None:
        self._per_second, self._burst = per_second, burst
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()  # address -> requests left, time

    def allows(self, address: str) -> bool:
        """Count a request and return whether it may be answered."""
        now = time.monotonic()
        left, before = self._left.pop(address, (self._burst, now))
        left = min(self._burst, left + (now - before) * self._per_second)
        self._left[address] = (left - 1 if left >= 1 else left, now)
        if len(self._left) > MAX_ADDRESSES:
            self._left.popitem(last=False)
        return left >= 1


class Connection(H11Protocol):
    """A connection that keeps nobody out: of more than MAX_CONNECTIONS, the one closest to its deadline is closed."""

    deadline: asyncio.TimerHandle

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.deadline = self.loop.call_later(REQUEST_S, transport.abort)
        if len(self.connections) > MAX_CONNECTIONS:
            connections = [each for each in self.connections if isinstance(each, Connection)]
            oldest = min(connections, key=lambda each: each.deadline.when())
            self.connections.discard(oldest)
            oldest.transport.abort()

    def data_received(self, data: bytes) -> None:
        before = self.cycle
        super().data_received(data)
        if self.cycle is not before:  # a request has begun
            self._renew()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._renew()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self.deadline.cancel()

    def _renew(self) -> None:
        """Start the deadline again. Further bytes of the same request do not, so a slow request ends, too."""
        self.deadline.cancel()
        self.deadline = self.loop.call_later(REQUEST_S, self.transport.abort)


def _guards(
    requests_per_second: float, allowed_hosts: Collection[str]
) -> Callable[[Request, RequestResponseEndpoint], Awaitable[Response]]:
    """Return a middleware that limits requests, adds headers, and answers errors with JSON."""
    rate = Rate(requests_per_second, BURST_S * requests_per_second)
    names = {"localhost", *(name.lower() for name in allowed_hosts)}

    async def respond(request: Request, call_next: RequestResponseEndpoint) -> Response:
        try:
            if not rate.allows(request.client.host if request.client else ""):
                raise RefusedError(429, "Too many requests.")
            _check_headers(request, names)
            response = await call_next(request)
        except ClientDisconnect:
            response = Response(status_code=400)  # to nobody
        except RefusedError as error:
            # the rest of a body that was not read must not become the next request
            response = JSONResponse({"error": error.reason}, error.status, {"Connection": "close"})
        except (sqlite3.Error, CophyError) as error:  # a full disk, or a file that another program locks or moved
            log.error("%s %r: the answer file: %s", request.method, request.url.path, error)
            response = JSONResponse({"error": FAILED}, 503)
        except Exception as error:  # details are logged, not sent
            log.error("%s %r", request.method, request.url.path, exc_info=error)
            response = JSONResponse({"error": FAILED}, 500)
        response.headers.update(HEADERS)
        return response

    return respond


def _check_headers(request: Request, names: Collection[str]) -> None:
    """Check what a proxy or a browser could understand in another way than this server.

    Args:
        names: Allowed host names. Addresses are allowed, too: only names can be made to point here by another site.

    Raises:
        RefusedError: Its host is not allowed, or its length is stated twice.
    """
    try:
        name = urlsplit(f"//{request.headers.get('host', '')}").hostname or ""
        if name not in names:
            ipaddress.ip_address(name)
    except ValueError as error:
        raise RefusedError(400, "This study has no such host name; allowed_hosts= lists its names.") from error
    if "content-length" in request.headers and "transfer-encoding" in request.headers:
        raise RefusedError(400, "A request has Content-Length or Transfer-Encoding, not both.")


async def _read_json(request: Request) -> Any:
    """Return the decoded body of a request of our own pages.

    Raises:
        RefusedError: It is too large, not JSON, or sent by another site.
    """
    origin = request.headers.get("origin")
    if origin is not None and origin != f"{request.scope['scheme']}://{request.headers.get('host')}":
        raise RefusedError(403, "This request comes from another site.")
    if request.headers.get("content-type", "").split(";")[0] != "application/json":
        raise RefusedError(415, "This is not JSON.")
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > MAX_BODY_BYTES:
            raise RefusedError(413, "This is too large.")
    try:
        return json.loads(body)
    except (ValueError, RecursionError) as error:
        raise RefusedError(400, "This is not JSON.") from error


def make_app(sessions: Sessions, welcome: str, limits: Limits, allowed_hosts: Collection[str]) -> Starlette:
    """Return a study as an ASGI application.

    Args:
        sessions: Its participants.
        welcome: Text of the first page, Markdown; HTML in it is shown as text.
        limits: Limits of one address.
        allowed_hosts: Names by which browsers reach it, besides addresses and localhost.
    """
    pages = _Pages(sessions, welcome, limits)
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
    guards = Middleware(BaseHTTPMiddleware, dispatch=_guards(limits.requests_per_second, allowed_hosts))
    app = Starlette(routes=routes, middleware=[guards])
    app.router.redirect_slashes = False  # every page has one address
    return app


class _Pages:
    def __init__(self, sessions: Sessions, welcome: str, limits: Limits) -> None:
        self._sessions, self._experiments = sessions, sessions.experiments
        self._welcome = MarkdownIt("commonmark", {"html": False}).render(welcome)
        self._consents = Rate(limits.people_per_minute / 60, limits.people_per_minute)

    async def index(self, request: Request) -> Response:
        return FileResponse(WEB / "index.html")

    async def welcome(self, request: Request) -> Response:
        return JSONResponse({"html": self._welcome})

    async def consent(self, request: Request) -> Response:
        body = await _read_json(request)
        if not isinstance(body, dict) or body.get("agreed") is not True:
            raise RefusedError(400, "The study does not begin without consent.")
        platform_id, token = _check_platform_id(body.get("platform_id")), body.get("token")
        if token is not None and not (isinstance(token, str) and TOKEN.fullmatch(token)):
            raise RefusedError(400, "This is not a token of 32 bytes.")
        try:
            return self._respond(await run_sync(self._sessions.place, request.cookies.get(COOKIE), platform_id))
        except RefusedError as error:  # this browser has no session yet
            if request.client is not None and not self._consents.allows(request.client.host):
                reason = "Too many people begin from this address. Please try again in a minute."
                raise RefusedError(429, reason) from error
        session = await run_sync(self._sessions.consent, platform_id, token)
        response = self._respond(await run_sync(self._sessions.place, session))
        secure = request.url.scheme == "https"
        response.set_cookie(COOKIE, session, COOKIE_AGE_S, httponly=True, samesite="strict", secure=secure)
        return response

    async def place(self, request: Request) -> Response:
        platform_id = _check_platform_id(request.query_params.get("platform_id"))
        return self._respond(await run_sync(self._sessions.place, request.cookies.get(COOKIE), platform_id))

    async def begin(self, request: Request) -> Response:
        await _read_json(request)
        token, position = request.cookies.get(COOKIE), request.path_params["position"]
        return self._respond(await run_sync(self._sessions.begin, token, position))

    async def answer(self, request: Request) -> Response:
        body, position = await _read_json(request), request.path_params["position"]
        task = await run_sync(self._sessions.answer, request.cookies.get(COOKIE), position, body)
        is_practice = position < len(self._experiments.practice)
        ends = {"ends": self._experiments.scenes.ends(task.experiment)} if is_practice else {}
        return JSONResponse({"stored": True, **ends})

    async def media(self, request: Request) -> Response:
        """Send the image or the clip of the participant's current task, and of no other."""
        place = await run_sync(self._sessions.place, request.cookies.get(COOKIE))
        task, kind = place.task, request.path_params["kind"]
        is_current = task is not None and request.path_params["position"] == place.position and kind in MEDIA
        if task is None or not is_current or (kind == "clip" and task.setting != "cf"):
            raise RefusedError(404, "There is no such image.")
        name, media_type = MEDIA[kind]
        content = await run_sync(self._experiments.file(task.experiment, name).read_bytes)
        return Response(content, media_type=media_type)

    def _respond(self, place: Place) -> Response:
        """Send what a browser may know of the participant's place."""
        num_practice, position = len(self._experiments.practice), place.position
        content = {"position": position, "num_practice": num_practice, "num_positions": len(place.tasks)}
        if place.task is None:
            return JSONResponse(content | {"code": place.code})
        details = {
            "is_practice": position < num_practice,
            "seconds": self._sessions.settings.seconds,
            "remaining_s": place.remaining_s,
            "resolution": self._sessions.settings.resolution,
            "objects": self._experiments.scenes.objects(place.task.experiment),
            "picture": f"/media/{position}/picture",
            "clip": f"/media/{position}/clip" if place.task.setting == "cf" else None,
        }
        return JSONResponse(content | details)


def _check_platform_id(value: Any) -> str | None:
    """Return an id of a crowd platform, or None if there is none.

    Raises:
        RefusedError: It is not a short text.
    """
    if value is None:
        return None
    if not isinstance(value, str) or not 1 <= len(value) <= MAX_PLATFORM_ID or not value.isprintable():
        raise RefusedError(400, "This is not the id of a platform.")
    return value


def serve(app: Starlette, listener: socket.socket, trusted_proxies: str) -> None:
    """Serve an application until it is interrupted.

    Args:
        app: See `make_app`.
        listener: See `listen`.
        trusted_proxies: Addresses whose X-Forwarded-* headers are trusted.
    """
    config = uvicorn.Config(
        app,
        http=Connection,
        ws="none",
        forwarded_allow_ips=trusted_proxies,
        timeout_keep_alive=KEEP_ALIVE_S,
        access_log=False,
        server_header=False,
        log_config=None,
    )
    with suppress(KeyboardInterrupt):  # uvicorn has shut down by then
        uvicorn.Server(config).run(sockets=[listener])


def welcome_text(path: str | None, settings: StudySettings) -> str:
    """Return the Markdown of the first page with {seconds} and {minutes} filled in.

    Raises:
        CophyError: The file is not text.
    """
    try:
        text = Path(path or WEB / "text" / "welcome.md").read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise CophyError(f"welcome={path} is not text: save it as UTF-8 ({error.reason})") from error
    tasks = settings.num_tasks + len(SETTINGS)  # one practice task of each setting
    minutes = math.ceil(tasks * (settings.seconds + READING_S) / 60)
    return text.replace("{seconds}", f"{settings.seconds:g}").replace("{minutes}", str(minutes))


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Raises:
        CophyError: Another program uses the port, or this machine has no such address.
    """
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:  # create_server appends where it failed
        reason = str(error.strerror or error).partition(" (while")[0]
        remedy = f"; try port={port + 1}" if error.errno == errno.EADDRINUSE else ""
        raise CophyError(f"host={host} port={port}: {reason}{remedy}") from error
