"""The page as it is served: nobody shuts others out, nobody's leaving is a fault, and files are their owner's."""

from __future__ import annotations

import re
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from jointid.apps.web import application as serving
from jointid.apps.web.folder import Limits
from tests.apps.web.asking import MULTIPART, TOKEN, Served, parts


@pytest.fixture
def limits() -> Limits:
    return Limits(upload=2_000_000, joint_file=20_000, arriving=4_000_000)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Starlette leaves its spool open
def test_uploads_that_stand_still_shut_nobody_out(served: Served, log: bytes) -> None:
    with ExitStack() as stalled:
        for _ in range(85):
            stalled.enter_context(served.begin_upload(declared=20_000))
        assert served.ask("GET", "/")[0] == 200
        status, _ = served.ask("POST", "/record", parts(log), MULTIPART)
        assert status == 303


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Starlette leaves its spool open
def test_no_more_comes_in_than_there_is_room_for(served: Served, log: bytes, folder: Path) -> None:
    with ExitStack() as stalled:
        for _ in range(2):
            stalled.enter_context(served.begin_upload(declared=1_990_000))
        for _ in range(200):
            status, said = served.ask("POST", "/record", parts(log), MULTIPART)
            if status == 422:
                break
        assert b"leave no room for this one; send it again later" in said
    for _ in range(200):  # those that have gone keep no room
        status, _ = served.ask("POST", "/record", parts(log), MULTIPART)
        if status == 303:
            break
    assert status == 303
    assert len([*folder.glob("upload-*.csv")]) == 1


class TestHasty:
    """A page that waits a moment only."""

    @pytest.fixture
    def limits(self) -> Limits:
        return Limits(idle=0.2)

    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
    def test_a_request_that_stands_still_is_ended(self, served: Served) -> None:
        with served.begin_upload(declared=20_000) as stalled:
            assert stalled.recv(4096).startswith(b"HTTP/1.1 408 ")
            while stalled.recv(4096):
                pass  # to the end, which comes

    def test_progress_is_sent_to_whoever_waits_longer(self, served: Served, folder: Path) -> None:
        (folder / "runs" / "1").mkdir(parents=True)
        (folder / "runs" / "1" / "run.json").write_text('{"state": "running"}')
        with served.connect() as watching:
            watching.sendall(f"GET /{TOKEN}/runs/1/events HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n".encode())
            assert watching.recv(4096).startswith(b"HTTP/1.1 200 ")
            (folder / "runs" / "1" / "progress.txt").write_text("one\n")
            assert b'"one"' in watching.recv(4096)


def test_a_connection_that_never_asks_is_closed(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_HEADER_TIME", 0.2)
    for begun in (b"", b"GET / HTTP/1.1\r\nhost: 127"):
        with served.connect() as silent:
            silent.sendall(begun)
            assert silent.recv(100) == b""


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Starlette leaves its spool open
def test_a_visitor_who_hangs_up_is_no_fault(
    served: Served, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    for _ in range(5):
        served.begin_upload(declared=20_000).close()
    for path in ("/draft", "/joint", "/again"):
        with served.connect() as gone:
            kind = "content-type: application/x-www-form-urlencoded"
            head = f"POST /{TOKEN}{path} HTTP/1.1\r\nhost: 127.0.0.1\r\n{kind}\r\ncontent-length: 99\r\n\r\njoint"
            gone.sendall(head.encode())
    for _ in range(20):  # the loop has seen them go before it answers this
        assert served.ask("GET", "/")[0] == 200
    assert "Traceback" not in caplog.text
    assert "Exception" not in caplog.text
    assert "Traceback" not in "".join(capfd.readouterr())


@pytest.mark.skipif(sys.platform == "win32", reason="Windows tells by other means who may read a file")
def test_what_the_page_writes_is_its_owners_alone(served: Served, folder: Path, log: bytes) -> None:
    assert served.ask("POST", "/record", parts(log), MULTIPART)[0] == 303
    entries = "joint.kind=prismatic&record.channels.torque.unit%40prismatic=N"
    entries += "&record.channels.reference.unit%40prismatic=m&record.channels.motor_position.unit%40prismatic=m"
    form = "application/x-www-form-urlencoded"
    assert served.ask("POST", "/channels", entries.encode(), form)[0] == 303
    entries = "controller.law=cascade&controller.position_gain=60&controller.velocity_gain=500"
    assert served.ask("POST", "/joint", entries.encode(), form)[0] == 303
    assert served.ask("POST", "/runs/1/cancel")[0] == 303
    written = [*folder.rglob("*")]
    assert any(re.fullmatch(r"upload-\w+\.csv", path.name) for path in written)
    for path in written:
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path
