"""Participants take the study over HTTP: order, clock, restarts, and what is stored."""

import sqlite3
import time
from pathlib import Path

import pytest

from cophy.study.answers import PERSON, AnswerStore
from cophy.study.sessions import Sessions
from tests.study.conftest import Site, answer_to, take_task


def test_from_consent_to_code(site: Site) -> None:
    browser = site.participant()
    for position in range(4):
        place = browser.get("/api/place").json()
        image = browser.get(place["picture"])
        assert image.status_code == 200
        assert image.content.startswith(b"\x89PNG")
        clip = browser.get(f"/media/{position}/clip")
        assert clip.status_code == (200 if place["clip"] else 404)
        assert not place["clip"] or clip.content.startswith(b"\x1aE\xdf\xa3")  # WebM
        assert browser.get(f"/media/{position + 1}/picture").status_code == 404
        assert ("ends" in take_task(browser)) == (position < 2)  # only practice shows the truth
        assert browser.get(f"/media/{position}/picture").status_code == 404
    place = browser.get("/api/place").json()
    assert place["position"] == 4
    assert len(place["code"]) == 10
    assert site.rows("SELECT count(*), sum(practice), count(answered_at), sum(late) FROM answers") == [(4, 2, 4, 0)]
    assert site.rows("SELECT setting FROM answers WHERE practice=0 ORDER BY setting") == [("cf",), ("non_cf",)]
    assert {row[0] for row in site.rows("SELECT x FROM clicks")} == {31.5}
    assert site.rows("SELECT finished_at IS NOT NULL FROM participants") == [(1,)]


def test_objects_that_were_not_clicked_are_missing(site: Site) -> None:
    browser, answer = site.begun()
    first, *others = answer["clicks"]
    assert browser.post("/api/assignments/0/answer", json=answer | {"clicks": [first]}).status_code == 200
    stored = dict(site.rows("SELECT slot, x IS NULL FROM clicks"))
    assert stored == {first["slot"]: 0, **{click["slot"]: 1 for click in others}}


def test_the_server_keeps_the_clock_and_starts_it_once(site: Site) -> None:
    browser = site.participant()
    assert browser.get("/api/place").json()["remaining_s"] is None
    assert browser.post("/api/assignments/0/begin", json={}).json()["remaining_s"] == 10
    site.clock.now += 4
    assert browser.post("/api/assignments/0/begin", json={}).json()["remaining_s"] == 6
    assert browser.get("/api/place").json()["remaining_s"] == 6


@pytest.mark.parametrize("hours", [-1, 1])
def test_setting_the_clock_of_the_machine_changes_no_deadline(
    site: Site, hours: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, error_s = time.time, [0.0]
    monkeypatch.setattr(time, "time", lambda: real() + error_s[0])
    sessions = Sessions(site.sessions.store, site.sessions.experiments, PERSON)
    token = sessions.consent(None)
    sessions.begin(token, 0)
    error_s[0] = 3600.0 * hours
    place = sessions.place(token)
    assert place.position == 0
    assert place.remaining_s == pytest.approx(10, abs=5)


def test_a_clock_that_was_set_back_before_a_restart_gives_nobody_time(site: Site) -> None:
    browser, answer = site.begun()
    site.clock.now -= 3600
    assert browser.post("/api/assignments/0/answer", json=answer).status_code == 409
    assert browser.get("/api/place").json()["position"] == 1
    assert site.rows("SELECT late FROM answers WHERE position=0") == [(1,)]


def test_an_answer_within_the_tolerance_counts_and_a_later_one_does_not(site: Site) -> None:
    browser, answer = site.begun()
    site.clock.now += 12.9
    assert browser.post("/api/assignments/0/answer", json=answer).status_code == 200
    answer = answer_to(browser.get("/api/place").json())
    browser.post("/api/assignments/1/begin", json={})
    site.clock.now += 13.1
    assert browser.post("/api/assignments/1/answer", json=answer).status_code == 409
    assert browser.get("/api/place").json()["position"] == 2
    assert site.rows("SELECT late FROM answers WHERE position=1") == [(1,)]
    assert {row[0] for row in site.rows("SELECT x FROM clicks WHERE position=1")} == {None}


def test_the_same_answer_may_be_sent_again_and_another_may_not(site: Site) -> None:
    browser, answer = site.begun()
    responses = [browser.post("/api/assignments/0/answer", json=answer) for _ in range(2)]
    assert [response.status_code for response in responses] == [200, 200]
    assert responses[0].json() == responses[1].json()
    assert browser.post("/api/assignments/0/answer", json=answer | {"undone": 1}).status_code == 409
    assert site.rows("SELECT count(*), max(undone) FROM answers WHERE answered_at IS NOT NULL") == [(1, 0)]


def test_participants_continue_after_a_restart_of_the_server(site: Site) -> None:
    browser = site.participant()
    take_task(browser)
    restarted = Site(Sessions(AnswerStore(site.path), site.sessions.experiments, PERSON), site.path)
    again = restarted.browser(cookies=dict(browser.cookies)).get("/api/place").json()
    assert again == browser.get("/api/place").json()
    assert again["position"] == 1
    restarted.sessions.store.close()


def test_a_second_consent_in_the_same_browser_adds_no_participant(site: Site) -> None:
    browser = site.participant()
    take_task(browser)
    assert browser.post("/api/consent", json={"agreed": True}).json()["position"] == 1
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]


def test_the_id_of_a_platform_takes_part_once_and_is_not_stored(site: Site, tmp_path: Path) -> None:
    content = {"agreed": True, "platform_id": "5f3c0ffee-prolific"}
    assert site.browser().post("/api/consent", json=content).status_code == 200
    assert site.browser().post("/api/consent", json=content).status_code == 409
    assert not [path for path in tmp_path.glob("answers.sqlite*") if b"5f3c0ffee" in path.read_bytes()]


def test_another_id_in_the_same_browser_is_another_participant(site: Site) -> None:
    """As on a laboratory's computer, which one participant uses after another."""
    browser = site.browser()
    assert browser.post("/api/consent", json={"agreed": True, "platform_id": "1"}).status_code == 200
    take_task(browser)
    for parameters in ({}, {"platform_id": "1"}):
        assert browser.get("/api/place", params=parameters).json()["position"] == 1
    assert browser.get("/api/place", params={"platform_id": "2"}).status_code == 401
    assert browser.post("/api/consent", json={"agreed": True, "platform_id": "2"}).json()["position"] == 0
    assert browser.get("/api/place", params={"platform_id": "2"}).json()["position"] == 0
    assert browser.post("/api/consent", json={"agreed": True, "platform_id": "1"}).status_code == 409
    assert site.rows("SELECT count(*) FROM participants") == [(2,)]


@pytest.mark.parametrize("platform_id", [{}, {"platform_id": "somebody"}], ids=["without id", "with id"])
def test_a_consent_that_is_sent_twice_adds_one_participant(site: Site, platform_id: dict[str, str]) -> None:
    content = {"agreed": True, "token": "a-_" * 14 + "b", **platform_id}
    for _ in range(2):
        assert site.browser().post("/api/consent", json=content).status_code == 200
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]
    response = site.browser().post("/api/consent", json=content | {"token": "c" * 43})
    assert response.status_code == (409 if platform_id else 200)


def test_participants_of_another_study_have_no_session(site: Site) -> None:
    browser = site.participant()
    site.sessions.study = "another"
    assert browser.get("/api/place").status_code == 401


@pytest.mark.parametrize("deleted", [0, 2])
def test_the_next_participant_takes_the_number_of_a_deleted_one(site: Site, deleted: int) -> None:
    """Deletion as in the docstring of cophy.study.answers; the plan stays balanced."""
    browsers = [site.participant() for _ in range(3)]
    for browser in browsers:
        take_task(browser)
    code = site.rows("SELECT code FROM participants ORDER BY number")[deleted][0]
    with sqlite3.connect(site.path) as db:
        (participant,) = db.execute("SELECT id FROM participants WHERE code = ?", (code,)).fetchone()
        for table, column in (("clicks", "participant"), ("answers", "participant"), ("participants", "id")):
            db.execute(f"DELETE FROM {table} WHERE {column} = ?", (participant,))
    db.close()
    take_task(site.participant())
    take_task(site.participant())
    assert site.rows("SELECT number FROM participants ORDER BY number") == [(0,), (1,), (2,), (3,)]
    assert site.rows("SELECT count(*) FROM answers WHERE answered_at IS NOT NULL") == [(4,)]
    assert [browser.get("/api/place").status_code for browser in browsers].count(401) == 1
