"""`jointid serve`: where it listens, what it says, and what it refuses."""

import re
import socket
import sys
from pathlib import Path
from urllib.parse import urlencode

import pytest

from jointid.common.files import lock
from tests.apps.web.asking import MULTIPART, TOKEN, UNITS, Served, parts
from tests.rigid_axis import run


@pytest.mark.parametrize("module", ["uvicorn", "starlette", "python_multipart"])
def test_a_missing_package_is_refused(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    assert run("serve", "--folder", tmp_path) == 2


def test_a_port_or_a_folder_that_is_taken_or_none_is_refused(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert run("serve", "--port", taken.getsockname()[1], "--folder", tmp_path / "page") == 2
    assert (tmp_path / "page").stat().st_mode & 0o777 == 0o700, "its owner's alone"
    assert run("serve", "--port", 99999, "--folder", tmp_path / "page") == 2
    assert run("serve", "--folder", tmp_path / "page" / "_lock" / "page") == 2, "below a file"
    with (tmp_path / "_lock").open("a") as held:
        assert lock(held.fileno())
        assert run("serve", "--port", 0, "--folder", tmp_path) == 2


def test_the_address_holds_a_token_that_is_new_at_each_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("uvicorn.Server.run", lambda server, sockets: None)
    tmp_path.chmod(0o755)
    for _ in range(2):
        assert run("serve", "--port", 0, "--folder", tmp_path) == 0
    said = capsys.readouterr()
    first, second = re.findall(r"http://127\.0\.0\.1:[0-9]+/([A-Za-z0-9_-]{32})/", said.out)
    assert first != second
    if sys.platform != "win32":
        assert said.err.count("Warning") == 2


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Starlette leaves its spool open
def test_a_visitor_who_hangs_up_is_no_fault(
    served: Served, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    for _ in range(5):
        served.begin_upload(declared=20_000).close()
    for path in ("/draft/joint", "/joint"):
        with served.connect() as gone:
            kind = "content-type: application/x-www-form-urlencoded"
            head = f"POST /{TOKEN}{path} HTTP/1.1\r\nhost: 127.0.0.1\r\n{kind}\r\ncontent-length: 99\r\n\r\njoint"
            gone.sendall(head.encode())
    for _ in range(20):  # the loop has seen them go before it answers this
        assert served.ask("GET", "/")[0] == 200
    assert "Traceback" not in caplog.text
    assert "Exception" not in caplog.text
    assert "Traceback" not in "".join(capfd.readouterr())


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows tells by other means who may read a file")
def test_what_the_page_writes_is_its_owners_alone(served: Served, folder: Path, log: bytes) -> None:
    assert served.ask("POST", "/record", parts(log), MULTIPART)[0] == 303
    entries = urlencode(UNITS)
    form = "application/x-www-form-urlencoded"
    assert served.ask("POST", "/channels", entries.encode(), form)[0] == 303
    entries = "controller.law=cascade&controller.position_gain=60&controller.velocity_gain=500"
    assert served.ask("POST", "/joint", entries.encode(), form)[0] == 303
    assert served.ask("POST", "/runs/1")[0] == 303
    written = [*folder.rglob("*")]
    assert any(path.name == "log.csv" for path in written)
    for path in written:
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path
