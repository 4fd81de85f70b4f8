"""A participant goes through the study over HTTP: order, clock, restarts, and what is stored."""

import sqlite3
from pathlib import Path

import pytest

from tests.study.conftest import Site, Time, answer_to, opened, take_one


def test_from_consent_to_code(site: Site) -> None:
    browser = site.participant()
    said = [take_one(browser) for _ in range(4)]
    assert ["ends" in each for each in said] == [True, True, False, False]  # practice alone tells the truth
    place = browser.get("/api/place").json()
    assert place["position"] == 4
    assert len(place["code"]) == 10
    assert site.rows("SELECT count(*), sum(practice), count(answered_at), sum(late) FROM answers") == [(4, 2, 4, 0)]
    assert site.rows("SELECT setting FROM answers WHERE practice=0 ORDER BY setting") == [("cf",), ("non_cf",)]
    assert {row[0] for row in site.rows("SELECT x FROM clicks")} == {31.5}
    assert site.rows("SELECT finished_at IS NOT NULL FROM participants") == [(1,)]


def test_media_are_of_the_current_assignment_alone(site: Site) -> None:
    browser = site.participant()
    for position in range(4):
        place = browser.get("/api/place").json()
        picture = browser.get(place["picture"])
        assert picture.status_code == 200
        assert picture.content.startswith(b"\x89PNG")
        clip = browser.get(f"/media/{position}/clip")
        assert clip.status_code == (200 if place["clip"] else 404)
        assert not place["clip"] or clip.content.startswith(b"\x1aE\xdf\xa3")  # WebM
        assert browser.get(f"/media/{position + 1}/picture").status_code == 404
        take_one(browser)
        assert browser.get(f"/media/{position}/picture").status_code == 404


def test_what_was_not_clicked_is_missing(site: Site) -> None:
    browser = site.participant()
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/0/begin", json={})
    clicks = answer_to(place)["clicks"][:1]
    assert browser.post("/api/assignments/0/answer", json=answer_to(place, clicks=clicks)).status_code == 200
    stored = site.rows("SELECT slot, x IS NULL FROM clicks ORDER BY slot")
    assert dict(stored) == {each["slot"]: int(each["slot"] != clicks[0]["slot"]) for each in place["objects"]}


def test_the_clock_is_the_servers_and_begins_once(site: Site) -> None:
    browser = site.participant()
    assert browser.get("/api/place").json()["remaining_s"] is None
    assert browser.post("/api/assignments/0/begin", json={}).json()["remaining_s"] == 10
    site.time.now += 4
    assert browser.post("/api/assignments/0/begin", json={}).json()["remaining_s"] == 6
    assert browser.get("/api/place").json()["remaining_s"] == 6


def test_an_answer_within_the_tolerance_counts_and_a_later_one_does_not(site: Site) -> None:
    browser = site.participant()
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/0/begin", json={})
    site.time.now += 12.9
    assert browser.post("/api/assignments/0/answer", json=answer_to(place)).status_code == 200
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/1/begin", json={})
    site.time.now += 13.1
    assert browser.post("/api/assignments/1/answer", json=answer_to(place)).status_code == 409
    assert browser.get("/api/place").json()["position"] == 2
    assert site.rows("SELECT late FROM answers WHERE position=1") == [(1,)]
    assert {row[0] for row in site.rows("SELECT x FROM clicks WHERE position=1")} == {None}


def test_the_same_answer_again_is_acknowledged_and_another_is_not(site: Site) -> None:
    browser = site.participant()
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/0/begin", json={})
    first = browser.post("/api/assignments/0/answer", json=answer_to(place))
    again = browser.post("/api/assignments/0/answer", json=answer_to(place))
    assert again.status_code == 200
    assert again.json() == first.json()
    assert browser.post("/api/assignments/0/answer", json=answer_to(place, undone=1)).status_code == 409
    assert site.rows("SELECT count(*), max(undone) FROM answers WHERE answered_at IS NOT NULL") == [(1, 0)]


def test_a_server_that_starts_again_goes_on(site: Site, tiny_data: Path, pictures: Path, tmp_path: Path) -> None:
    browser = site.participant()
    take_one(browser)
    again = opened(tmp_path / "answers.sqlite", tiny_data, pictures, Time())
    other = again.visitor(cookies=dict(browser.cookies))
    assert other.get("/api/place").json() == browser.get("/api/place").json()
    assert other.get("/api/place").json()["position"] == 1
    again.store.close()


def test_consent_again_in_the_same_browser_is_no_second_participant(site: Site) -> None:
    browser = site.participant()
    take_one(browser)
    assert browser.post("/api/consent", json={"agreed": True}).json()["position"] == 1
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]


def test_the_id_of_a_platform_takes_part_once_and_is_not_stored(site: Site, tmp_path: Path) -> None:
    content = {"agreed": True, "platform_id": "5f3c0ffee-prolific"}
    assert site.visitor().post("/api/consent", json=content).status_code == 200
    assert site.visitor().post("/api/consent", json=content).status_code == 409
    assert not [path for path in tmp_path.glob("answers.sqlite*") if b"5f3c0ffee" in path.read_bytes()]


def test_another_id_in_the_same_browser_is_another_person(site: Site) -> None:
    """A laboratory's computer, on which one person follows another."""
    browser = site.visitor()
    assert browser.post("/api/consent", json={"agreed": True, "platform_id": "1"}).status_code == 200
    take_one(browser)
    for known in ({}, {"platform_id": "1"}):
        assert browser.get("/api/place", params=known).json()["position"] == 1
    assert browser.get("/api/place", params={"platform_id": "2"}).status_code == 401
    assert browser.post("/api/consent", json={"agreed": True, "platform_id": "2"}).json()["position"] == 0
    assert browser.get("/api/place", params={"platform_id": "2"}).json()["position"] == 0
    assert browser.post("/api/consent", json={"agreed": True, "platform_id": "1"}).status_code == 409
    assert site.rows("SELECT count(*) FROM participants") == [(2,)]


@pytest.mark.parametrize("named", [{}, {"platform_id": "somebody"}], ids=["nobody", "somebody"])
def test_a_consent_whose_answer_was_lost_is_the_same_when_it_is_sent_again(site: Site, named: dict[str, str]) -> None:
    content = {"agreed": True, "token": "a-_" * 14 + "b", **named}
    lost, again, another = site.visitor(), site.visitor(), site.visitor()
    assert lost.post("/api/consent", json=content).status_code == 200
    assert again.post("/api/consent", json=content).status_code == 200
    assert site.rows("SELECT count(*) FROM participants") == [(1,)]
    take_one(again)
    other = another.post("/api/consent", json=content | {"token": "c" * 43})
    assert other.status_code == (409 if named else 200)


def test_another_size_of_the_study_does_not_take_over_its_people(site: Site) -> None:
    browser = site.participant()
    site.study.sessions.study = "another"
    assert browser.get("/api/place").status_code == 401


@pytest.mark.parametrize("deleted", [0, 1, 2])
def test_who_is_deleted_leaves_a_place_to_the_next(site: Site, tmp_path: Path, deleted: int) -> None:
    """As docs/study.md says it is done; so the plan stays even."""
    people = [site.participant() for _ in range(3)]
    for browser in people:
        take_one(browser)
    code = site.rows("SELECT code FROM participants ORDER BY number")[deleted][0]
    with sqlite3.connect(tmp_path / "answers.sqlite") as db:
        (participant,) = db.execute("SELECT id FROM participants WHERE code = ?", (code,)).fetchone()
        for table, column in (("clicks", "participant"), ("answers", "participant"), ("participants", "id")):
            db.execute(f"DELETE FROM {table} WHERE {column} = ?", (participant,))
    db.close()
    take_one(site.participant())
    take_one(site.participant())
    assert site.rows("SELECT number FROM participants ORDER BY number") == [(0,), (1,), (2,), (3,)]
    assert site.rows("SELECT count(*) FROM answers WHERE answered_at IS NOT NULL") == [(4,)]
    assert [browser.get("/api/place").status_code for browser in people].count(401) == 1
