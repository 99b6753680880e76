"""A folder of the page that is damaged, or comes from somebody else: a sentence, and no file from elsewhere."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import pytest

from jointid.apps.web.application import build_application
from jointid.apps.web.folder import Folder, PageError
from tests.apps.web.asking import ADDRESS, TOKEN
from tests.apps.web.testclient import TestClient

DEEP = "[" * 100_000
SECRET = "kept-out-of-sight"


@pytest.fixture
def run(folder: Path) -> Path:
    """The folder of an identification that ended."""
    (folder.parent / "secret.txt").write_text(SECRET)
    path = folder / "runs" / "1"
    path.mkdir(parents=True)
    (path / "run.json").write_text(json.dumps({"state": "done", "sentence": "", "started": 1.0, "ended": 2.0}))
    (path / "log.csv").write_text("1,2\n")
    (path / "work.json").write_text(json.dumps({"files": ["log.csv"]}))
    (path / "answer.json").write_text("{}")
    return path


@pytest.mark.parametrize(
    "work",
    ["", "{}", "[]", DEEP, '{"files": 1}', '{"files": ["log.csv", "../../../secret.txt"]}', '{"files": ["link.csv"]}'],
)
def test_an_archive_holds_files_of_its_own_folder_alone(run: Path, client: TestClient, work: str) -> None:
    with zipfile.ZipFile(io.BytesIO(client.get("/runs/1/all.zip").content)) as archive:
        assert set(archive.namelist()) == {"answer.json", "log.csv"}
    (run / "link.csv").symlink_to(run.parents[2] / "secret.txt")
    (run / "work.json").write_text(work)
    answer = client.get("/runs/1/all.zip")
    assert answer.status_code == 422
    assert SECRET not in answer.text


def test_no_link_leads_out_of_the_folder(run: Path, folder: Path, client: TestClient) -> None:
    secret = folder.parent / "secret.txt"
    (run / "all.zip").symlink_to(secret)
    assert zipfile.is_zipfile(io.BytesIO(client.get("/runs/1/all.zip").content))
    (folder / "now").mkdir()
    (folder / "now" / "draft.json").symlink_to(secret)
    assert client.post("/draft", data={"name": "axis"}).status_code == 204
    (folder / "now" / "a.csv").write_text("t,x\n1,2\n")
    (folder / "now" / "sent.json").write_text('{"files": ["a.csv"]}')
    (folder / "now" / "columns.json").symlink_to(secret)
    (folder / "now" / "log.txt").symlink_to(secret)
    assert client.post("/again").status_code == 422
    (run / "answer.json").unlink()
    for name in ("progress.txt", "answer.txt", "answer.json"):
        (run / name).symlink_to(secret)
    assert SECRET not in client.get("/runs/1").text
    (folder / "runs" / "2").symlink_to(run)
    assert client.get("/runs/2/log.csv").status_code == client.get("/runs/2").status_code == 404
    (folder / "runs").rename(folder.parent / "elsewhere")
    (folder / "runs").symlink_to(folder.parent / "elsewhere")
    assert client.get("/runs/1").status_code == 404
    with pytest.raises(PageError):
        Folder(folder).new_run()
    assert secret.read_text() == SECRET


@pytest.mark.parametrize("content", ["", "{}", "7", DEEP, '{"state": 1}', '{"state": "running", "started": "x"}'])
def test_the_page_starts_with_a_folder_that_is_damaged(run: Path, folder: Path, content: str) -> None:
    (folder / "runs" / "\u00b2").mkdir()
    (folder / "now").mkdir()
    (run / "answer.json").unlink()
    for path in (*(folder / "now" / f"{one}.json" for one in ("sent", "draft", "checked")), run / "run.json"):
        path.write_text(content)
    with TestClient(build_application(folder, TOKEN), base_url=ADDRESS) as client:
        for address in ("/", "/channels", "/joint", "/runs/1"):
            assert client.get(address).status_code == 200, address
