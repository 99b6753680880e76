"""The page as it is served: nobody shuts others out, nobody's leaving is a fault, and files are their owner's."""

from __future__ import annotations

import sys
from pathlib import Path
from urllib.parse import urlencode

import pytest

from tests.apps.web.asking import MULTIPART, TOKEN, UNITS, Served, parts


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
