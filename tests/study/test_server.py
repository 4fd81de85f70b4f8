"""The server refuses what a hostile browser may try, never sends D before the answer, and survives its own errors."""

import json
import logging
import shutil
import socket
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from httpx import Response
from starlette.testclient import TestClient

from cophy.errors import CophyError
from cophy.study import server as server_module
from cophy.study.plan import Limits
from cophy.study.server import listen, make_app, welcome_text
from tests.study.conftest import GENEROUS, HOSTS, SMALL, Site, answer_to, serving, take_task

JSON = {"content-type": "application/json"}
CLICK = {"x": 3, "y": 4, "at_ms": 5}
BAD_ANSWERS: tuple[dict[str, Any], ...] = (
    {"clicks": "all"},
    {"clicks": [{"slot": 99, **CLICK}]},
    {"clicks": [{"slot": "0; DROP TABLE clicks", **CLICK}]},
    {"clicks": [{"slot": True, **CLICK}]},
    {"clicks": [{"slot": 0, **CLICK}, {"slot": 0, **CLICK}]},
    {"clicks": [{"slot": 0, **CLICK}] * 20},
    *({"clicks": [{"slot": 0, **CLICK, **change}]} for change in ({"x": -0.1}, {"x": 64.1}, {"y": 1e300}, {"x": None})),
    *({"clicks": [{"slot": 0, **CLICK, **change}]} for change in ({"at_ms": 13_001}, {"z": 1}, {"x": float("nan")})),
    {"undone": -1},
    {"undone": 10**30},
    {"names_shown": "yes"},
    {"input": "<script>alert(1)</script>"},
    {"window": [0, 0]},
    {"window": [800, 600, 1]},
    {"experiment": 3},
    {"late": 0, "answered_at": 0},
)


def test_bad_answers_are_refused_and_the_task_stays_open(site: Site) -> None:
    browser, answer = site.begun()
    for change in BAD_ANSWERS:
        content = json.dumps(answer | change)  # json.dumps writes NaN, which browsers do not
        assert browser.post("/api/assignments/0/answer", content=content, headers=JSON).status_code == 422, change
    assert site.rows("SELECT count(*) FROM clicks") == [(0,)]
    assert browser.post("/api/assignments/0/answer", json=answer).status_code == 200


@pytest.mark.parametrize(
    ("body", "kind", "status"),
    [
        (b"x" * 5000, "application/json", 413),
        (b"[" * 4000, "application/json", 400),
        (b"\xff\xfe", "application/json", 400),
        (b"", "application/json", 400),
        (b"agreed=true", "application/x-www-form-urlencoded", 415),
    ],
)
def test_bodies_that_are_not_json_are_refused(site: Site, body: bytes, kind: str, status: int) -> None:
    browser = site.participant()
    for path in ("/api/assignments/0/answer", "/api/assignments/0/begin", "/api/consent"):
        assert browser.post(path, content=body, headers={"content-type": kind}).status_code == status


def test_an_endless_body_is_not_read_to_its_end(site: Site) -> None:
    def send() -> Iterator[bytes]:
        for _ in range(10_000):
            yield b" " * 1000

    response = site.participant().post("/api/assignments/0/answer", content=send(), headers=JSON)
    assert response.status_code == 413


def test_tasks_cannot_be_taken_out_of_order_or_before_the_clock(site: Site) -> None:
    browser = site.participant()
    answer = answer_to(browser.get("/api/place").json())
    for position in (1, 4, 10**25):
        assert browser.post(f"/api/assignments/{position}/begin", json={}).status_code == 409
        assert browser.post(f"/api/assignments/{position}/answer", json=answer).status_code == 409
    response = browser.post("/api/assignments/0/answer", json=answer)
    assert response.status_code == 409
    assert "ends" not in response.json()


def test_only_a_valid_token_opens_a_session(site: Site) -> None:
    site.participant()
    for token in (None, "", "' OR '1'='1", "x" * 43, "%00", "../../etc/passwd"):
        browser = site.browser(cookies={} if token is None else {"cophy_study": token})
        assert browser.get("/api/place").status_code == 401
        assert browser.get("/media/0/picture").status_code == 401
        assert browser.post("/api/assignments/0/begin", json={}).status_code == 401
        assert browser.post("/api/assignments/0/answer", json={}).status_code == 401


def test_the_token_is_in_the_cookie_alone_and_only_its_hash_is_stored(site: Site) -> None:
    browser = site.browser(base_url="https://study.example")
    response = browser.post("/api/consent", json={"agreed": True})
    assert all(word in response.headers["set-cookie"] for word in ("HttpOnly", "SameSite=strict", "Secure"))
    token = browser.cookies["cophy_study"]
    assert len(token) >= 43
    assert token not in response.text
    assert token not in str(site.rows("SELECT * FROM participants"))


def test_participants_do_not_change_each_others_answers(site: Site) -> None:
    first, second = site.participant(), site.participant()
    take_task(first)
    before = site.rows("SELECT * FROM clicks WHERE participant=1")
    take_task(second)
    assert site.rows("SELECT * FROM clicks WHERE participant=1") == before
    assert first.get("/api/place").json()["position"] == 1


def test_no_path_leads_out_of_the_web_folder(site: Site) -> None:
    browser = site.participant()
    for path in (
        *("/web/../sessions.py", "/web/%2e%2e/sessions.py", "/web/..%2f..%2fsessions.py", "/web//etc/passwd"),
        *("/media/0/..%2f..%2fanswers.sqlite", "/media/0/10-c.png", "/media/-1/picture", "/media/0/picture%00"),
        *("/media/0;DROP TABLE answers/picture", "/answers.sqlite", "/api/assignments/1%20OR%201=1/begin"),
    ):
        assert browser.get(path).status_code in (404, 405), path


def test_another_site_changes_nothing(site: Site) -> None:
    participant, browser = site.participant(), site.browser()
    for origin in (
        "https://evil.example",
        "http://[",
        "null",
        "http://",
        "http://testserver.evil.example",
        "https://testserver",
    ):
        headers = {"origin": origin}
        assert participant.post("/api/assignments/0/begin", json={}, headers=headers).status_code == 403
        assert browser.post("/api/consent", json={"agreed": True}, headers=headers).status_code == 403
    assert site.rows("SELECT count(*), count(begun_at) FROM participants LEFT JOIN answers ON 1") == [(1, 0)]


@pytest.mark.parametrize(
    ("host", "status"),
    [
        *((host, 200) for host in ("testserver", "Study.Example", "localhost:8000", "127.0.0.1:8000", "[::1]:8000")),
        *((host, 400) for host in ("evil.example", "evil.example:8000", "localhost.evil.example", "127.0.0.1.nip.io")),
        *((host, 400) for host in ("", "[", "[::1", "localhost.", "0x7f.1", ":8000")),
    ],
)
def test_only_allowed_host_names_are_served(site: Site, host: str, status: int) -> None:
    """The page of another site, whose name points to this machine, has the same host and origin."""
    headers = {"host": host, "origin": f"http://{host}"}
    assert site.browser().get("/", headers=headers).status_code == status
    assert site.browser().post("/api/consent", json={"agreed": True}, headers=headers).status_code == status
    assert site.rows("SELECT count(*) FROM participants") == [(int(status == 200),)]


@pytest.mark.parametrize("path", ["/web", "/media/0/picture/", "/api/place/", "//evil.example/web"])
def test_nothing_is_redirected(site: Site, path: str) -> None:
    response = site.participant().get(f"http://testserver{path}", follow_redirects=False)
    assert response.status_code == 404
    assert "location" not in response.headers


def test_a_body_whose_length_is_stated_twice_is_refused_and_the_connection_closed(site: Site) -> None:
    headers = {"transfer-encoding": "chunked", "content-length": "16", **JSON}
    response = site.browser().post("/api/consent", content=b'{"agreed": true}', headers=headers)
    assert (response.status_code, response.headers["connection"]) == (400, "close")
    assert site.rows("SELECT count(*) FROM participants") == [(0,)]


def test_nobody_takes_part_without_consent_and_valid_ids(site: Site) -> None:
    browser = site.browser()
    for body in (
        *({}, {"agreed": False}, {"agreed": "yes"}, []),
        *({"agreed": True, "platform_id": value} for value in ("x" * 129, "", 3, "\ud800", "a\udfffb")),
        *({"agreed": True, "token": value} for value in ("", 3, "a" * 42, "a" * 44, "ä" * 43, "a" * 43 + "\n", ["a"])),
    ):
        assert browser.post("/api/consent", content=json.dumps(body), headers=JSON).status_code == 400, body
    assert site.rows("SELECT count(*) FROM participants") == [(0,)]


def test_requests_and_new_participants_per_address_are_limited(site: Site) -> None:
    site.limits = Limits(requests_per_second=2, people_per_minute=3)
    browser = site.browser()
    assert [browser.get("/api/welcome").status_code for _ in range(12)].count(429) >= 1
    site.limits = Limits(requests_per_second=10_000, people_per_minute=3)
    browser, statuses = site.browser(), []
    for _ in range(5):
        browser.cookies.clear()
        statuses.append(browser.post("/api/consent", json={"agreed": True}).status_code)
    assert statuses == [200, 200, 200, 429, 429]


def has_headers(response: Response) -> bool:
    headers = response.headers
    policy = headers["content-security-policy"]
    is_strict = "script-src 'self';" in policy and "default-src 'none'" in policy
    return is_strict and headers["cache-control"] == "no-store" and headers["x-content-type-options"] == "nosniff"


def test_every_response_has_the_headers(site: Site) -> None:
    browser = site.browser()
    assert all(has_headers(browser.get(path)) for path in ("/", "/api/place", "/web/study.css", "/nothing"))
    assert not any(text in browser.get("/").text for text in ("http://", "https://", "onclick"))


def test_markup_in_the_welcome_text_is_shown_as_text(site: Site) -> None:
    welcome = "# Hello\n<script>alert(1)</script> [x](javascript:alert(1))"
    html = TestClient(make_app(site.sessions, welcome, GENEROUS, HOSTS)).get("/api/welcome").json()["html"]
    assert "<h1>Hello</h1>" in html
    assert "<script" not in html
    assert 'href="javascript' not in html


def test_the_welcome_text_has_the_duration_and_must_be_utf_8(tmp_path: Path) -> None:
    assert "You have 10 seconds" in welcome_text(None, SMALL)
    assert "about 2 minutes" in welcome_text(None, SMALL)  # 4 tasks of 10 + 10 s
    (tmp_path / "welcome.md").write_bytes("Grüße".encode("latin-1"))
    with pytest.raises(CophyError, match=r"welcome.md is not text: save it as UTF-8"):
        welcome_text(tmp_path / "welcome.md", SMALL)


def test_a_host_that_does_not_exist_is_named() -> None:
    with pytest.raises(CophyError, match=r"^host=nosuchhost.invalid port=8000: ") as raised:
        listen("nosuchhost.invalid", 8000)
    assert "try port" not in str(raised.value)


def numbers_in(content: Any) -> list[float]:
    """Return all numbers in decoded JSON."""
    if isinstance(content, dict | list):
        values = content.values() if isinstance(content, dict) else content
        return [number for value in values for number in numbers_in(value)]
    return [float(content)] if isinstance(content, int | float) and not isinstance(content, bool) else []


def contains(content: Any, position: tuple[float, float]) -> bool:
    """Return whether both coordinates are among the numbers, to a tenth of a pixel."""
    return all(any(abs(number - value) < 0.06 for number in numbers_in(content)) for value in position)


def test_ends_of_d_are_sent_only_after_the_answer_to_a_practice_task(site: Site) -> None:
    browser, scenes, num_moving = site.participant(), site.sessions.experiments.scenes, 0
    for _ in range(4):
        place = browser.get("/api/place").json()
        task = site.sessions.place(browser.cookies["cophy_study"]).task
        assert task is not None
        starts, ends = scenes.starts(task.experiment), scenes.ends(task.experiment)
        moving = {slot: end for slot, end in ends.items() if np.hypot(*np.subtract(end, starts[slot])) > 1}
        num_moving += len(moving)
        begun = browser.post(f"/api/assignments/{place['position']}/begin", json={}).json()
        assert not [slot for slot, end in moving.items() if contains([place, begun], end)]
        response = take_task(browser)
        sent = [slot for slot, end in moving.items() if contains(response, end)]
        assert sent == (list(moving) if place["is_practice"] else [])
    assert num_moving > 0


def test_no_response_contains_a_path_of_the_disk(site: Site) -> None:
    browser = site.participant()
    directory = str(site.sessions.experiments.directory).encode()
    for path in ("/", "/api/place", "/api/welcome", "/media/0/picture", "/web/study.js", "/media/9/picture", "/web/x"):
        assert directory not in browser.get(path).content


def test_an_error_of_the_server_is_logged_and_sent_without_details(
    site: Site, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = site.participant()
    monkeypatch.setattr(site.sessions.experiments, "file", lambda *_: Path("/nowhere/secret.png"))
    response = browser.get("/media/0/picture")
    assert response.status_code == 500
    assert "load this page again" in response.json()["error"]
    assert "nowhere" not in response.text
    assert has_headers(response)
    assert "FileNotFoundError" in caplog.text


def test_an_answer_that_cannot_be_stored_is_stored_when_it_is_sent_again(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    browser, answer = site.begun()
    with site.sessions.store.transaction() as db:
        pass
    db.execute("PRAGMA query_only=ON")
    with caplog.at_level(logging.ERROR):
        response = browser.post("/api/assignments/0/answer", json=answer)
    assert response.status_code == 503
    assert has_headers(response)
    assert "POST '/api/assignments/0/answer': the answer file: attempt to write" in caplog.text
    db.execute("PRAGMA query_only=OFF")
    assert browser.post("/api/assignments/0/answer", json=answer).status_code == 200
    assert site.rows("SELECT count(*) FROM answers WHERE answered_at IS NOT NULL") == [(1,)]


@pytest.mark.parametrize("name", ["answers.sqlite", "answers.sqlite-wal"])
@pytest.mark.parametrize("is_replaced", [False, True])
def test_no_answer_is_acknowledged_while_the_file_is_not_in_place(site: Site, name: str, is_replaced: bool) -> None:
    browser, answer = site.begun()
    path, moved = site.path.with_name(name), site.path.with_name("moved")
    path.rename(moved)
    if is_replaced:
        shutil.copy(moved, path)
    response = browser.post("/api/assignments/0/answer", json=answer)
    assert response.status_code == 503
    assert "load this page again" in response.json()["error"]
    moved.replace(path)
    assert browser.post("/api/assignments/0/answer", json=answer).status_code == 200
    assert site.rows("SELECT count(*) FROM answers WHERE answered_at IS NOT NULL") == [(1,)]


HALF = b"POST /api/consent HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 99\r\n\r\n{"


@pytest.fixture
def address(site: Site, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, int]]:
    """Where a real server serves the study to at most five connections."""
    monkeypatch.setattr(server_module, "MAX_CONNECTIONS", 5)
    with serving(site) as address:
        yield address


@pytest.mark.parametrize("sent", [b"", HALF[:40], HALF], ids=["nothing", "half a head", "half a body"])
def test_connections_that_wait_keep_nobody_out(address: tuple[str, int], sent: bytes) -> None:
    with ExitStack() as stack:
        for _ in range(20):
            stack.enter_context(socket.create_connection(address)).sendall(sent)
        assert httpx.get(f"http://127.0.0.1:{address[1]}/api/welcome").status_code == 200


@pytest.mark.parametrize("sent", [b"", HALF[:40], HALF], ids=["nothing", "half a head", "half a body"])
def test_a_connection_that_waits_is_closed(
    address: tuple[str, int], sent: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "REQUEST_S", 0.3)
    with socket.create_connection(address, timeout=10) as connection:
        connection.sendall(sent)
        with suppress(ConnectionResetError):  # it was closed before it had read everything
            assert connection.recv(1) == b""


def test_a_body_that_is_cut_off_is_not_logged(address: tuple[str, int], caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(5):
        with socket.create_connection(address) as connection:
            connection.sendall(HALF)
    assert httpx.get(f"http://127.0.0.1:{address[1]}/api/place").status_code == 401  # so those have ended
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]
