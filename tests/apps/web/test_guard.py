"""Who may ask the page, and what a browser may do with its answers."""

from __future__ import annotations

from pathlib import Path

import pytest

from jointid.apps.web.application import application
from jointid.apps.web.limits import Limits
from jointid.apps.web.sessions import Sessions
from tests.apps.web.asking import ORIGIN, Asker
from tests.apps.web.testclient import TestClient


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {**ORIGIN, "sec-fetch-site": "cross-site"},
    ],
)
@pytest.mark.parametrize("path", ["/record", "/example", "/draft", "/joint", "/forget", "/runs/1/cancel"])
def test_other_sites_cannot_have_a_browser_send_forms(client: TestClient, headers: dict[str, str], path: str) -> None:
    assert client.post(path, headers=headers).status_code == 403


def test_the_page_itself_can(client: TestClient) -> None:
    assert client.post("/forget", headers=ORIGIN).status_code == 200
    assert client.post("/forget", headers={"sec-fetch-site": "same-origin"}).status_code == 200


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "", "[", "127.0.0.1.evil.example", "10.0.0.1"])
def test_a_name_that_was_rebound_to_this_machine_is_refused(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"host": host}).status_code == 403


@pytest.mark.parametrize("host", ["localhost:1", "127.0.0.1:8765", "[::1]:8765", "LOCALHOST"])
def test_the_names_of_this_machine_are_not(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"host": host}).status_code == 200


def test_a_page_on_the_network_is_reached_by_its_number(folder: Path) -> None:
    client = TestClient(application(folder, host="0.0.0.0"))
    assert client.get("/", headers={"host": "192.168.1.7:8765"}).status_code == 200
    assert client.get("/", headers={"host": "evil.example"}).status_code == 403


@pytest.mark.parametrize("path", ["/", "/static/page.js", "/nothing", "/runs/1"])
def test_every_answer_tells_browsers_how_little_it_may_do(client: TestClient, path: str) -> None:
    headers = client.get(path).headers
    assert headers["x-content-type-options"] == "nosniff"
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy


def test_pages_bring_no_script_or_style_of_their_own(client: TestClient, asker: Asker, log: bytes) -> None:
    asker.send("log.csv", log)
    for path in ("/", "/channels", "/joint"):
        text = client.get(path).text
        assert "<style" not in text
        assert " style=" not in text
        assert " onclick" not in text
        assert text.count("<script") == text.count('<script src="/static/page.js"') == 1


def test_the_cookie_is_for_this_page_alone(client: TestClient, log: bytes) -> None:
    assert "set-cookie" not in client.get("/").headers
    answer = client.post("/record", files={"file": ("log.csv", log)}, headers=ORIGIN, follow_redirects=False)
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie


def test_a_cookie_that_is_not_ours_leads_nowhere(client: TestClient, folder: Path) -> None:
    for token in ("../../etc", "x", "a" * 43):
        client.cookies.set(client.app.state.desk.cookie, token)  # type: ignore[attr-defined]
        assert client.get("/runs/1").status_code == 404
    assert not list(folder.glob("*")) if folder.exists() else True


def test_nobody_is_given_a_cookie_that_somebody_else_chose(client: TestClient, asker: Asker, log: bytes) -> None:
    name = client.app.state.desk.cookie  # type: ignore[attr-defined]
    headers = {**ORIGIN, "cookie": f"{name}={'a' * 43}"}
    answer = client.post("/record", files={"file": ("log.csv", log)}, headers=headers, follow_redirects=False)
    assert answer.status_code == 303
    assert client.cookies[name] != "a" * 43
    assert asker.visitor.record is not None
    again = client.post("/record", files={"file": ("log.csv", log)}, headers=ORIGIN, follow_redirects=False)
    assert f"{name}={client.cookies[name]}" in again.headers["set-cookie"]  # one who was here stays who they are


def test_pages_of_two_folders_on_one_host_have_cookies_of_their_own(folder: Path, limits: Limits) -> None:
    names = {Sessions(place, limits).cookie for place in (folder, folder / "..", folder / ".." / folder.name)}
    assert len(names) == 2


def test_a_record_that_is_refused_leaves_no_folder_without_a_cookie(client: TestClient, asker: Asker) -> None:
    headers = {**ORIGIN, "accept": "application/json"}
    answer = client.post("/record", files={"file": ("a.csv", b"no numbers")}, headers=headers)
    assert answer.status_code == 422
    assert asker.visitor.folder.is_dir()


@pytest.mark.parametrize("path", ["/static/../application.py", "/static/%2e%2e/worker.py", "/runs/1/run.json", "/x"])
def test_only_what_is_meant_to_be_had_is_given(client: TestClient, path: str) -> None:
    assert client.get(path).status_code == 404


@pytest.mark.parametrize("digits", [300, 5000])
def test_a_number_of_many_digits_leads_nowhere(client: TestClient, asker: Asker, log: bytes, digits: int) -> None:
    asker.send("log.csv", log)
    for path in (f"/runs/{'9' * digits}", f"/plot/{'9' * digits}.svg"):
        assert client.get(path).status_code == 404


@pytest.mark.parametrize("last", ["9" * 5000, "²"])
def test_a_place_in_the_progress_that_is_no_number_is_the_beginning(
    client: TestClient, asker: Asker, log: bytes, limits: Limits, last: str
) -> None:
    asker.send("log.csv", log)
    asker.visitor.new_run(limits).update(state="done")
    answer = client.get("/runs/1/events", headers={"last-event-id": last.encode("latin-1")})
    assert "event: state" in answer.text
