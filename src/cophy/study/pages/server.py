"""The pages of a study and their addresses. Of experiments, only what the participant's own place allows is ever sent."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from anyio.to_thread import run_sync
from markdown_it import MarkdownIt
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from cophy.study.answers import BadAnswerError
from cophy.study.experiments import StudyExperiments
from cophy.study.pages.browser_clips import CLIP, PICTURE, Clips
from cophy.study.pages.guards import Guards, Rate, json_of
from cophy.study.sessions import Place, RefusedError, Sessions
from cophy.study.study_settings import Limits

WEB = Path(__file__).parents[1] / "web"
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
