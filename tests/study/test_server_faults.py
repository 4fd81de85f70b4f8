"""What fails in the server is told, stored when it comes again, and harms nothing else."""

import logging
import sqlite3
from pathlib import Path

import pytest

from tests.study.conftest import Site, answer_to, has_its_headers


def test_what_fails_in_the_server_is_said_as_json_and_logged(
    site: Site, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = site.participant()
    picture = browser.get("/api/place").json()["picture"]
    monkeypatch.setattr(site.study.clips, "path", lambda *_: Path("/nowhere/secret.png"))
    failed = browser.get(picture)
    assert failed.status_code == 500
    assert "load this page again" in failed.json()["error"]
    assert "nowhere" not in failed.text
    assert has_its_headers(failed)
    assert "FileNotFoundError" in caplog.text


def test_an_answer_that_cannot_be_stored_is_stored_when_it_comes_again(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    browser = site.participant()
    place = browser.get("/api/place").json()
    browser.post("/api/assignments/0/begin", json={})
    with site.store.transaction() as db:
        pass
    db.execute("PRAGMA query_only=ON")
    with caplog.at_level(logging.ERROR):
        failed = browser.post("/api/assignments/0/answer", json=answer_to(place))
    assert failed.status_code == 503
    assert "load this page again" in failed.json()["error"]
    assert has_its_headers(failed)
    assert "POST '/api/assignments/0/answer': the file of answers: attempt to write" in caplog.text
    db.execute("PRAGMA query_only=OFF")
    assert browser.post("/api/assignments/0/answer", json=answer_to(place)).status_code == 200
    assert site.rows("SELECT count(*) FROM answers WHERE answered_at IS NOT NULL") == [(1,)]


def test_a_transaction_that_cannot_be_committed_leaves_the_next_one_alone(site: Site) -> None:
    def write() -> None:
        with site.store.transaction() as db:
            db.execute("PRAGMA defer_foreign_keys=ON")
            db.execute("INSERT INTO clicks VALUES (1, 2, 3, NULL, NULL, NULL)")  # of nobody: COMMIT refuses it

    with pytest.raises(sqlite3.IntegrityError):
        write()
    assert site.rows("SELECT count(*) FROM clicks") == [(0,)]
