"""Many people at once, over HTTP, while the server is killed and started again: nothing acknowledged is lost."""

import asyncio
import signal
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

PEOPLE, TASKS = 50, 1  # tasks of each setting: the tiny data have two twin pairs to test on
PORT = 8765
pytestmark = pytest.mark.slow


@dataclass
class Server:
    """study.py in a process of its own."""

    directory: Path
    data: Path
    tasks: int = TASKS
    pairs: int = 2 * TASKS
    size: str = "tiny"
    process: "subprocess.Popen[bytes] | None" = None

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{PORT}"

    def start(self) -> None:
        """Until it answers."""
        keys = {
            **{"size": self.size, "data_dir": self.data, "directory": self.directory, "port": PORT},
            **{"study.resolution": 64, "study.num_pairs": self.pairs, "study.num_assignments": self.tasks},
            **{"limits.requests_per_second": 100_000, "limits.people_per_minute": 100_000},
        }
        words = [f"{key}={value}" for key, value in keys.items()]
        self.process = subprocess.Popen([sys.executable, str(ROOT / "src" / "study.py"), *words])
        for _ in range(2400):
            assert self.process.poll() is None, "the server ended"
            try:
                httpx.get(f"{self.address}/api/welcome")
            except httpx.TransportError:
                time.sleep(0.25)
            else:
                return
        raise AssertionError("the server did not start in ten minutes")

    def kill(self, how: signal.Signals = signal.SIGKILL) -> None:
        assert self.process is not None
        self.process.send_signal(how)
        self.process.wait()


@dataclass
class Crowd:
    """People who answer without a pause, and what they were told.

    Attributes:
        acknowledged: Session and position of every answer that the server said it stored, with its first click's x.
        seconds: What each request that was answered took.
        codes: Of those who are done.
    """

    acknowledged: dict[tuple[str, int], float] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    codes: list[str] = field(default_factory=list)

    async def take(self, address: str, people: int) -> None:
        """All at once, to the end."""
        limits = httpx.Limits(max_connections=people)
        async with asyncio.TaskGroup() as group:
            for number in range(people):
                group.create_task(self._one(address, limits, np.random.default_rng(number)))

    async def _one(self, address: str, limits: httpx.Limits, rng: np.random.Generator) -> None:
        async with httpx.AsyncClient(base_url=address, limits=limits, timeout=30) as browser:
            place = (await self._ask(browser, "POST", "/api/consent", {"agreed": True})).json()
            while "code" not in place:
                position = place["position"]
                await self._ask(browser, "GET", place["picture"])
                await self._ask(browser, "POST", f"/api/assignments/{position}/begin", {})
                x = round(float(rng.uniform(0, 64)), 3)
                clicks = [{"slot": each["slot"], "x": x, "y": 20, "at_ms": 900} for each in place["objects"]]
                said = answer_to(place, clicks=clicks)
                answered = await self._ask(browser, "POST", f"/api/assignments/{position}/answer", said)
                assert answered.status_code == 200, answered.text
                self.acknowledged[browser.cookies["cophy_study"], position] = x
                place = (await self._ask(browser, "GET", "/api/place")).json()
            self.codes.append(place["code"])

    async def _ask(self, browser: httpx.AsyncClient, method: str, path: str, body: object = None) -> httpx.Response:
        """Again and again while the server is away, as the page does."""
        while True:
            start = time.perf_counter()
            try:
                response = await browser.request(method, path, json=body)
            except httpx.TransportError:
                await asyncio.sleep(0.2)
                continue
            self.seconds.append(time.perf_counter() - start)
            return response


@pytest.fixture
def server(tiny_data: Path, tmp_path: Path) -> Iterator[Server]:
    found = Server(tmp_path, tiny_data)
    found.start()
    yield found
    found.kill(signal.SIGTERM)


async def _take_and_kill(server: Server, crowd: Crowd, people: int) -> None:
    """The crowd goes through; amid it the server dies twice."""
    taking = asyncio.create_task(crowd.take(server.address, people))
    for part in (0.2, 0.6):
        while len(crowd.acknowledged) < part * people * (2 * server.tasks + 2):
            await asyncio.sleep(0.02)
        server.kill()
        await asyncio.to_thread(server.start)
    await taking


def test_nothing_that_was_acknowledged_is_lost(server: Server, tmp_path: Path) -> None:
    crowd = Crowd()
    asyncio.run(_take_and_kill(server, crowd, PEOPLE))
    with sqlite3.connect(tmp_path / "answers.sqlite") as db:
        codes = {code for (code,) in db.execute("SELECT code FROM participants WHERE finished_at IS NOT NULL")}
        stored = db.execute("SELECT count(*), sum(late) FROM answers WHERE answered_at IS NOT NULL").fetchone()
        per_answer = "SELECT min(x), max(x) FROM clicks GROUP BY participant, position"
        clicks = sorted(low for low, high in db.execute(per_answer) if low == high)
        numbers = db.execute("SELECT count(*), count(DISTINCT number), max(number) FROM participants").fetchone()
    total = PEOPLE * (2 * TASKS + 2)
    assert set(crowd.codes) <= codes
    assert len(set(crowd.codes)) == PEOPLE
    assert len(crowd.acknowledged) == total
    assert stored[0] >= total
    assert stored[1] == 0
    # every click that was acknowledged is in the file as it was sent
    assert not set(crowd.acknowledged.values()) - set(clicks)
    assert numbers[0] == numbers[1] == numbers[2] + 1
