"""Simulated participants go through the pages of a study, as a browser would, many at once."""

import asyncio
from contextlib import AsyncExitStack
from typing import Any

import httpx
import numpy as np
from starlette.applications import Starlette
from tqdm import tqdm

from cophy.errors import CophyError
from cophy.study.pages.server import COOKIE
from cophy.study.pages.serving import OpenStudy
from cophy.study.simulation.strategies import Pixels, Strategy

AT_ONCE = 20  # participants
WINDOW = [800, 600]  # CSS pixels, of a browser that is none


def take_study(study: OpenStudy, app: Starlette, strategy: Strategy, *, participants: int, seed: int) -> None:
    """Let participants take the study, in this process but over its HTTP interface.

    Args:
        study: Whose participants are of a simulated kind.
        app: Its pages.
        strategy: How they answer.
        participants: How many.
        seed: Of their answers.

    Raises:
        CophyError: The pages refused one of them.
    """
    asyncio.run(_all(study, app, strategy, np.random.SeedSequence(seed).spawn(participants)))


async def _all(study: OpenStudy, app: Starlette, strategy: Strategy, seeds: list[np.random.SeedSequence]) -> None:
    free = asyncio.Semaphore(AT_ONCE)
    async with AsyncExitStack() as stack:
        # an address of each one's own: the limits are meant for people who share one
        transports = [httpx.ASGITransport(app=app, client=(f"simulated-{n}", 0)) for n in range(len(seeds))]
        browsers = [
            await stack.enter_async_context(httpx.AsyncClient(transport=each, base_url="http://study"))
            for each in transports
        ]
        for browser in browsers:  # one after the other, so that each has its place in the plan at every call
            _said(await browser.post("/api/consent", json={"agreed": True}))
        with tqdm(total=len(seeds), desc=study.sessions.kind) as bar:

            async def one(browser: httpx.AsyncClient, seed: np.random.SeedSequence) -> None:
                async with free:
                    await _visit(study, browser, strategy, np.random.default_rng(seed))
                bar.update()

            await asyncio.gather(*map(one, browsers, seeds))


async def _visit(study: OpenStudy, browser: httpx.AsyncClient, strategy: Strategy, rng: np.random.Generator) -> None:
    """From the first task to the code."""
    place = _said(await browser.get("/api/place"))
    while "code" not in place:
        for media in filter(None, (place["picture"], place["clip"])):
            _said(await browser.get(media), is_json=False)
        address = f"/api/assignments/{place['position']}"
        _said(await browser.post(f"{address}/begin", json={}))
        # what is asked; the pages do not tell the number of the experiment
        assignment = study.sessions.place(browser.cookies[COOKIE]).assignment
        assert assignment is not None
        pixels = strategy(study.experiments.scenes, assignment, rng)
        _said(await browser.post(f"{address}/answer", json=_answer(place, pixels)))
        place = _said(await browser.get("/api/place"))


def _answer(place: dict[str, Any], pixels: Pixels) -> dict[str, Any]:
    """What a browser sends; clicks beside the picture go to its edge."""
    size, at_ms = place["resolution"], round(500 * place["seconds"])
    clicks = [
        {"slot": slot, **{axis: min(max(value, 0.0), float(size)) for axis, value in zip("xy", at, strict=True)}}
        for slot, at in pixels.items()
    ]
    timed = [{**click, "at_ms": at_ms} for click in clicks]
    return {"clicks": timed, "undone": 0, "names_shown": False, "input": "none", "window": WINDOW}


def _said(response: httpx.Response, *, is_json: bool = True) -> dict[str, Any]:
    if response.status_code != httpx.codes.OK:
        raise CophyError(f"the study refused a simulated participant: {response.status_code} {response.text[:200]}")
    return dict(response.json()) if is_json else {}
