"""Who may use the page, and what a browser may do with its answers."""

import asyncio
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

import pytest

from jointid.apps.web.routes import build_application
from tests.apps.web.asking import TOKEN, UNITS, Asker, TestClient

PAGE = "http://127.0.0.1:8765"
PATHS = ["/", "/record", "/channels", "/runs/1", "/runs/1/all.zip", "/static/page.js", "/nothing"]
WRONG = ["wrong", TOKEN[:-1], f"{TOKEN}0", TOKEN.upper(), "%FF", "%C3%A9", f"x/{TOKEN}", f"/{TOKEN}"]


@pytest.mark.parametrize("path", [*PATHS, *(f"/{wrong}/" for wrong in WRONG), f"/?token={TOKEN}"])
def test_without_the_token_nothing_is_there(client: TestClient, path: str) -> None:
    for method in ("GET", "POST"):
        answer = client.request(method, f"{PAGE}{path}")
        assert answer.status_code == 403
        assert TOKEN not in answer.text


@pytest.mark.slow
def test_pages_set_no_cookie_and_bring_no_script_of_their_own(client: TestClient, asker: Asker, log: bytes) -> None:
    asker.send("log.csv", log)
    asker.post("/channels", UNITS)
    asker.page.new_run("[joint]")
    paths = ["/", "/channels", "/joint", "/runs/1", "/runs/1/joint.toml", "/plot/0.svg", "/static/page.js", "/nothing"]
    answers = [client.get(path) for path in paths] + [client.post("/runs/1"), client.get(f"{PAGE}/wrong/")]
    assert not any("set-cookie" in one.headers for answer in answers for one in [*answer.history, answer])
    assert not client.cookies
    for text in (page.text for page in answers[:3]):
        assert not any(one in text for one in ("<style", " style=", " onclick"))
        assert text.count("<script") == text.count(f'<script src="/{TOKEN}/static/page.js"') == 1


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
@pytest.mark.parametrize("path", ["/record", "/example", "/draft/joint", "/joint", "/runs/1"])
def test_other_sites_cannot_have_a_browser_send_forms(client: TestClient, path: str, site: str) -> None:
    assert client.post(path, headers={"sec-fetch-site": site}).status_code == 403


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "", "[", "127.0.0.1.evil.example", "10.0.0.1"])
def test_a_name_that_was_rebound_to_this_machine_is_refused(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"host": host}).status_code == 400


@pytest.mark.parametrize("path", ["/", "/static/page.js", "/nothing", "/runs/1", "http://127.0.0.1:8765/"])
def test_every_answer_tells_browsers_how_little_it_may_do(client: TestClient, path: str) -> None:
    headers = client.get(path).headers
    assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")
    policy = headers["content-security-policy"]
    assert {"default-src 'none'", "frame-ancestors 'none'"} <= {*policy.split("; ")} and "unsafe" not in policy


@pytest.mark.parametrize("path", ["/static/../routes.py", "/static/%2e%2e/worker.py", "/runs/1/_run.json", "/x"])
def test_only_what_is_meant_to_be_had_is_given(client: TestClient, path: str) -> None:
    assert client.get(path).status_code == 404


def test_a_request_for_no_path_is_refused(folder: Path) -> None:
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(dict(message))

    scope = {"type": "http", "method": "OPTIONS", "path": "*", "headers": [(b"host", b"127.0.0.1")]}
    asyncio.run(build_application(folder, TOKEN)(scope, receive, send))
    assert sent[0]["status"] == 403
