"""Many participants at once over HTTP, while the server is killed and restarted: no acknowledged answer is lost."""

import asyncio
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
import pytest

from tests.conftest import ROOT
from tests.study.conftest import answer_to

NUM_PARTICIPANTS, NUM_TASKS = 50, 4  # practice included
with socket.create_server(("127.0.0.1", 0)) as listener:
    PORT = listener.getsockname()[1]  # free
URL = f"http://127.0.0.1:{PORT}"
pytestmark = pytest.mark.slow


@dataclass
class Server:
    """study.py in a process of its own."""

    directory: Path
    data: Path
    process: "subprocess.Popen[bytes] | None" = None

    def start(self) -> None:
        """Start the process and wait until it answers."""
        keys = {
            **{"size": "tiny", "data_dir": self.data, "directory": self.directory, "port": PORT},
            **{"study.resolution": 64, "study.num_pairs": 2, "study.num_assignments": 1},
            **{"limits.requests_per_second": 100_000, "limits.people_per_minute": 100_000},
        }
        words = [f"{key}={value}" for key, value in keys.items()]
        self.process = subprocess.Popen([sys.executable, str(ROOT / "src" / "study.py"), *words])
        for _ in range(1200):
            assert self.process.poll() is None, "the server ended"
            try:
                httpx.get(f"{URL}/api/welcome")
            except httpx.TransportError:
                time.sleep(0.25)
            else:
                return
        raise AssertionError("the server did not start in five minutes")

    def end(self, how: signal.Signals) -> None:
        assert self.process is not None
        self.process.send_signal(how)
        self.process.wait()


@dataclass
class Crowd:
    """Participants who answer without a pause.

    Attributes:
        acknowledged: x of the clicks, by session and position of every answer that the server acknowledged.
        codes: Completion codes of the participants who finished.
    """

    acknowledged: dict[tuple[str, int], float] = field(default_factory=dict)
    codes: list[str] = field(default_factory=list)

    async def take_study(self) -> None:
        async with asyncio.TaskGroup() as group:
            for number in range(NUM_PARTICIPANTS):
                group.create_task(self._take_study(np.random.default_rng(number)))

    async def _take_study(self, rng: np.random.Generator) -> None:
        async with httpx.AsyncClient(base_url=URL, timeout=30) as browser:
            place = (await _request(browser, "POST", "/api/consent", {"agreed": True})).json()
            while "code" not in place:
                position = place["position"]
                await _request(browser, "GET", place["picture"])
                await _request(browser, "POST", f"/api/assignments/{position}/begin", {})
                x = round(float(rng.uniform(0, 64)), 3)
                clicks = [{"slot": item["slot"], "x": x, "y": 20, "at_ms": 900} for item in place["objects"]]
                answer = answer_to(place, clicks=clicks)
                response = await _request(browser, "POST", f"/api/assignments/{position}/answer", answer)
                assert response.status_code == 200, response.text
                self.acknowledged[browser.cookies["cophy_study"], position] = x
                place = (await _request(browser, "GET", "/api/place")).json()
            self.codes.append(place["code"])


async def _request(browser: httpx.AsyncClient, method: str, path: str, body: object = None) -> httpx.Response:
    """Send a request, again while the server is away, as the page does."""
    while True:
        try:
            return await browser.request(method, path, json=body)
        except httpx.TransportError:
            await asyncio.sleep(0.2)


@pytest.fixture
def server(tiny_data: Path, tmp_path: Path) -> Iterator[Server]:
    server = Server(tmp_path, tiny_data)
    server.start()
    yield server
    server.end(signal.SIGTERM)


async def _take_study_and_kill(server: Server, crowd: Crowd) -> None:
    taking = asyncio.create_task(crowd.take_study())
    for share in (0.2, 0.6):
        while len(crowd.acknowledged) < share * NUM_PARTICIPANTS * NUM_TASKS:
            await asyncio.sleep(0.02)
        server.end(signal.SIGKILL)
        await asyncio.to_thread(server.start)
    await taking


def test_no_acknowledged_answer_is_lost(server: Server, tmp_path: Path) -> None:
    crowd = Crowd()
    asyncio.run(_take_study_and_kill(server, crowd))
    with sqlite3.connect(tmp_path / "answers.sqlite") as db:
        codes = {code for (code,) in db.execute("SELECT code FROM participants WHERE finished_at IS NOT NULL")}
        count, late = db.execute("SELECT count(*), sum(late) FROM answers WHERE answered_at IS NOT NULL").fetchone()
        clicks = {low for low, high in db.execute("SELECT min(x), max(x) FROM clicks GROUP BY participant, position")}
        numbers = db.execute("SELECT count(*), count(DISTINCT number), max(number) + 1 FROM participants").fetchone()
    assert len(set(crowd.codes)) == NUM_PARTICIPANTS
    assert set(crowd.codes) <= codes
    assert len(crowd.acknowledged) == NUM_PARTICIPANTS * NUM_TASKS <= count
    assert late == 0
    assert set(crowd.acknowledged.values()) <= clicks
    assert len(set(numbers)) == 1
