"""`jointid serve`: where it listens, what it says, and what it refuses."""

from __future__ import annotations

import re
import socket
import sys
from pathlib import Path

import pytest

from jointid.apps.cli import main


def served(*words: object) -> int:
    with pytest.raises(SystemExit) as end:
        main(["serve", *map(str, words)])
    assert isinstance(end.value.code, int)
    return end.value.code


@pytest.mark.parametrize("module", ["uvicorn", "starlette", "python_multipart"])
def test_a_missing_package_is_refused(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    assert served("--folder", tmp_path) == 2


def test_a_port_or_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert served("--port", taken.getsockname()[1], "--folder", tmp_path / "page") == 2
    assert served("--port", 99999, "--folder", tmp_path / "page") == 2
    assert served("--folder", tmp_path / "file" / "page") == 2


def test_the_folder_is_its_owners_alone(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        served("--port", taken.getsockname()[1], "--folder", tmp_path / "page")
    assert (tmp_path / "page").stat().st_mode & 0o777 == 0o700


def test_the_address_holds_a_token_that_is_new_at_each_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("uvicorn.Server.run", lambda server, sockets: None)
    tmp_path.chmod(0o755)
    for _ in range(2):
        assert served("--port", 0, "--folder", tmp_path) == 0
    said = capsys.readouterr()
    first, second = re.findall(r"http://127\.0\.0\.1:[0-9]+/([A-Za-z0-9_-]{32})/", said.out)
    assert first != second
    if sys.platform != "win32":
        assert said.err.count("Warning") == 2
