"""What a hostile browser may try, and that each is refused without a trace."""

import json
from typing import Any

import pytest
from starlette.testclient import TestClient

from cophy.study.settings import Limits
from tests.study.conftest import Site, answer_to, has_its_headers, take_one

CLICK = {"x": 3, "y": 4, "at_ms": 5}


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"clicks": "all"}, 422),
        ({"clicks": [{"slot": 99, **CLICK}]}, 422),
        ({"clicks": [{"slot": -1, **CLICK}]}, 422),
        ({"clicks": [{"slot": "0; DROP TABLE clicks", **CLICK}]}, 422),
        ({"clicks": [{"slot": True, **CLICK}]}, 422),
        ({"clicks": [{"slot": 0, **CLICK}] * 50}, 422),
        ({"undone": -1}, 422),
        ({"undone": 10**30}, 422),
        ({"names_shown": "yes"}, 422),
        ({"input": "<script>alert(1)</script>"}, 422),
        ({"window": [0, 0]}, 422),
        ({"window": [800, 600, 1]}, 422),
        ({"experiment": 3}, 422),
        ({"participant": 1}, 422),
        ({"late": 0, "answered_at": 0}, 422),
    ],
)
def test_malformed_and_forged_answers(site: Site, change: dict[str, Any], status: int) -> None:
    browser = site.participant()
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/0/begin", json={})
    response = browser.post("/api/assignments/0/answer", json=answer_to(place, **change))
    assert response.status_code == status, response.text
    assert site.rows("SELECT count(*) FROM clicks") == [(0,)]
    assert browser.post("/api/assignments/0/answer", json=answer_to(place)).status_code == 200


@pytest.mark.parametrize("change", [{"x": -0.1}, {"x": 64.1}, {"y": 1e300}, {"x": None}, {"at_ms": 13_001}, {"z": 1}])
def test_clicks_outside_the_picture_or_the_time(site: Site, change: dict[str, Any]) -> None:
    browser = site.participant()
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/0/begin", json={})
    content = answer_to(place)
    content["clicks"][0] |= change
    assert browser.post("/api/assignments/0/answer", json=content).status_code == 422
    assert site.rows("SELECT count(*) FROM clicks") == [(0,)]


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_are_none(site: Site, number: str) -> None:
    browser = site.participant()
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/0/begin", json={})
    body = json.dumps(answer_to(place)).replace("31.5", number)
    headers = {"content-type": "application/json"}
    assert browser.post("/api/assignments/0/answer", content=body, headers=headers).status_code in (400, 422)


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
def test_bodies_that_are_none(site: Site, body: bytes, kind: str, status: int) -> None:
    browser = site.participant()
    for path in ("/api/assignments/0/answer", "/api/assignments/0/begin"):
        assert browser.post(path, content=body, headers={"content-type": kind}).status_code == status
    visitor = site.visitor()
    assert visitor.post("/api/consent", content=body, headers={"content-type": kind}).status_code == status


def test_an_endless_body_is_cut(site: Site) -> None:
    sent = []

    def endless() -> Any:
        for _ in range(10_000):
            sent.append(1)
            yield b" " * 1000

    response = site.participant().post(
        "/api/assignments/0/answer", content=endless(), headers={"content-type": "application/json"}
    )
    assert response.status_code == 413


@pytest.mark.parametrize("position", [1, 3, 4, 10**25])
def test_assignments_out_of_turn(site: Site, position: int) -> None:
    browser = site.participant()
    place = browser.get("/api/place").json()
    assert browser.post(f"/api/assignments/{position}/begin", json={}).status_code == 409
    assert browser.post(f"/api/assignments/{position}/answer", json=answer_to(place)).status_code == 409


def test_an_answer_before_the_clock(site: Site) -> None:
    browser = site.participant()
    response = browser.post("/api/assignments/0/answer", json=answer_to(browser.get("/api/place").json()))
    assert response.status_code == 409
    assert "ends" not in response.json()


@pytest.mark.parametrize("token", [None, "", "0", "' OR '1'='1", "x" * 43, "%00", "../../etc/passwd"])
def test_sessions_of_nobody(site: Site, token: str | None) -> None:
    site.participant()
    visitor = site.visitor(cookies={} if token is None else {"cophy_study": token})
    assert visitor.get("/api/place").status_code == 401
    assert visitor.get("/media/0/picture").status_code == 401
    assert visitor.post("/api/assignments/0/begin", json={}).status_code == 401
    assert visitor.post("/api/assignments/0/answer", json={}).status_code == 401


def test_a_session_is_never_told_and_only_its_hash_is_stored(site: Site) -> None:
    browser = site.visitor(base_url="https://study.example")
    response = browser.post("/api/consent", json={"agreed": True})
    cookie = response.headers["set-cookie"]
    assert all(word in cookie for word in ("HttpOnly", "SameSite=strict", "Secure"))
    token = browser.cookies["cophy_study"]
    assert len(token) >= 43
    assert token not in response.text
    assert token not in str(site.rows("SELECT * FROM participants"))


def test_one_person_writes_nothing_of_another(site: Site) -> None:
    first, second = site.participant(), site.participant()
    take_one(first)
    before = site.rows("SELECT * FROM clicks WHERE participant=1")
    for _ in range(2):
        take_one(second)
    assert site.rows("SELECT * FROM clicks WHERE participant=1") == before
    assert first.get("/api/place").json()["position"] == 1


@pytest.mark.parametrize(
    "path",
    [
        "/web/../sessions.py",
        "/web/%2e%2e/sessions.py",
        "/web/..%2f..%2fsessions.py",
        "/web/%2e%2e%2f%2e%2e%2f%2e%2e%2fetc/passwd",
        "/web//etc/passwd",
        "/media/0/..%2f..%2fanswers.sqlite",
        "/media/0/10-c.png",
        "/media/-1/picture",
        "/media/0;DROP TABLE answers/picture",
        "/media/0/picture%00",
        "/answers.sqlite",
        "/api/assignments/1%20OR%201=1/begin",
    ],
)
def test_tricks_with_paths(site: Site, path: str) -> None:
    browser = site.participant()
    assert browser.get(path).status_code in (404, 405)


def test_an_address_that_is_too_long(site: Site) -> None:
    assert site.visitor().get("/?" + "a" * 600).status_code == 414


def test_another_site_writes_nothing(site: Site) -> None:
    headers = {"origin": "https://evil.example"}
    assert site.participant().post("/api/assignments/0/begin", json={}, headers=headers).status_code == 403
    assert site.visitor().post("/api/consent", json={"agreed": True}, headers=headers).status_code == 403


@pytest.mark.parametrize("origin", ["http://[", "null", "http://", "//[x]:", "http://testserver.evil.example"])
def test_what_is_no_address_of_ours_writes_nothing(site: Site, origin: str) -> None:
    assert site.visitor().post("/api/consent", json={"agreed": True}, headers={"origin": origin}).status_code == 403
    assert site.rows("SELECT count(*) FROM participants") == [(0,)]


@pytest.mark.parametrize(
    "body",
    [
        *({}, {"agreed": False}, {"agreed": "yes"}, []),
        *({"agreed": True, "platform_id": each} for each in ("x" * 129, "", 3, "\ud800", "a\udfffb")),
        *({"agreed": True, "token": each} for each in ("", 3, "a" * 42, "a" * 44, "ä" * 43, "a" * 43 + "\n", ["a"])),
    ],
)
def test_nothing_begins_without_consent(site: Site, body: Any) -> None:
    headers = {"content-type": "application/json"}
    assert site.visitor().post("/api/consent", content=json.dumps(body), headers=headers).status_code == 400
    assert site.rows("SELECT count(*) FROM participants") == [(0,)]


def test_rates_are_bounded(site: Site) -> None:
    site.limits = Limits(requests_per_second=2, people_per_minute=3)
    visitor = site.visitor()
    assert [visitor.get("/api/welcome").status_code for _ in range(12)].count(429) >= 1
    site.limits = Limits(requests_per_second=10_000, people_per_minute=3)
    visitor = site.visitor()
    begun = []
    for _ in range(5):
        visitor.cookies.clear()
        begun.append(visitor.post("/api/consent", json={"agreed": True}).status_code)
    assert begun == [200, 200, 200, 429, 429]


def test_every_response_has_its_headers(site: Site) -> None:
    for path in ("/", "/api/place", "/web/study.css", "/nothing"):
        assert has_its_headers(site.visitor().get(path))
    page = site.visitor().get("/").text
    assert "http://" not in page
    assert "https://" not in page
    assert "onclick" not in page


def test_markup_in_the_text_of_the_first_page_is_text(site: Site) -> None:
    welcome = "# Hello\n<script>alert(1)</script> [x](javascript:alert(1))"
    html = TestClient(site.study.app(welcome, site.limits)).get("/api/welcome").json()["html"]
    assert "<h1>Hello</h1>" in html
    assert "<script" not in html
    assert 'href="javascript' not in html
