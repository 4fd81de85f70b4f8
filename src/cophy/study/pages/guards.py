"""What every answer of the server carries, and what no browser may exceed."""

import json
import logging
import sqlite3
import time
from collections import OrderedDict
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cophy.study.sessions import RefusedError

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
log = logging.getLogger(__name__)


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
