"""kill -9, Ctrl-C and SIGTERM at random moments of every command that writes."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from jointid.common import files
from tests.losses.runs import COUNT, FIRST, SEED, contents, note, require_calm, run_program

pytestmark = [pytest.mark.hostile, pytest.mark.skipif(sys.platform != "linux", reason="copies of a process")]

OLD = b"what was there"
COMMANDS = {
    "data inspect": ("data inspect record.csv", "--json", "o.json", "--figure", "o.png"),
    "data convert": ("data convert record.csv o.h5",),
    "data convert to a bag": ("data convert table.csv o.mcap",),
    "identify": ("identify joint.toml -q", "--json", "o.json", "--figure", "o.svg"),
    "validate": ("validate joint.toml --estimate estimate.json -q", "--json", "o.json", "--residuals", "o.pdf"),
    "compare": ("compare estimate.json estimate.json", "--json", "o.json"),
    "export": ("export joint.toml --estimate estimate.json", "--out", "o.toml"),
    "simulate": ("simulate joint.toml --estimate estimate.json -q", "--out", "o.csv", "--json", "o.json"),
    "tune": ("tune joint.toml -q", "--json", "o.json", "--figure", "o.png"),
    "diagnose methods": ("diagnose methods joint.toml -q", "--json", "o.json"),
    "diagnose": ("diagnose joint.toml -q", "--json", "o.json"),
    "report": ("report joint.toml -q --no-profiles", "--html", "o.html", "--markdown", "pages", "--json", "o.json"),
    "demo": ("demo again -q",),
    "learn-controller": ("learn-controller joint.toml -q", "--write", "o.toml", "--json", "o.json"),
    "reproduce": ("reproduce -q", "--out", "pages"),
}
LONGEST = 6.0  # seconds in which a command is attacked; a search of minutes is not waited for
SLOW = ("report", "demo", "learn-controller", "reproduce")  # three moments, where few are asked for
ENDS = {".json": b"}\n", ".png": b"IEND\xaeB`\x82", ".svg": b"</svg>\n", ".pdf": b"%%EOF\n", ".html": b"</html>",
        ".toml": b"\n", ".csv": b"\n", ".md": b"\n"}  # fmt: skip


def is_whole(name: str, content: bytes) -> bool:
    suffix = Path(name).suffix
    if suffix == ".json":
        json.loads(content)
    if suffix == ".h5":
        return content.startswith(b"\x89HDF")
    if suffix == ".mcap":
        return content.endswith(b"\x89MCAP0\r\n")
    return content.rstrip().endswith(ENDS[suffix].rstrip())


@pytest.mark.parametrize("command", COMMANDS)
def test_nothing_is_lost_or_cut_at_any_moment(command: str, place: Path) -> None:
    words = " ".join(COMMANDS[command]).split()
    named = [word for word in words if word.startswith("o.")]
    for name in named:
        (place / name).write_bytes(OLD)
    before = contents(place)
    chance = random.Random(command + SEED)
    seconds = LONGEST
    for turn in range(3 if command in SLOW and COUNT < 20 else COUNT):
        kill = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)[turn % 3]
        ended = run_program(*words, folder=place, kill=kill, after=chance.uniform(0.0, seconds))
        seconds = min(seconds, 1.1 * ended.seconds) if ended.code == 0 else seconds
        require_calm(ended, (0, -kill, 128 + kill))
        found = contents(place)
        left = {name for name in found if name.startswith(".jointid-") or "/.jointid-" in name}
        assert not left or kill == signal.SIGKILL, left
        for name in found.keys() - left:
            if name in named or name not in before:
                assert found[name] == OLD or is_whole(name, found[name]), name
            else:
                assert found[name] == before[name], name
        assert before.keys() <= found.keys()
        for fresh in (*(place / name for name in found.keys() - before.keys()), *place.rglob(".jointid-*")):
            shutil.rmtree(fresh) if fresh.is_dir() else fresh.unlink(missing_ok=True)
        for name in named:
            (place / name).write_bytes(OLD)


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_nothing_is_left_at_any_line_of_writing(tmp_path: Path) -> None:
    """Ctrl-C before each line of what writes a file and each call of what removes one, and the end of the program."""
    at, lines, is_written = tmp_path / "o.json", {files.__file__, contextlib.__file__}, False
    for line in itertools.count():
        at.write_bytes(OLD)
        left = line

        def interrupt(frame: FrameType, event: str, _: object) -> Callable[..., Any] | None:
            nonlocal left
            if frame.f_code.co_filename not in {*lines, shutil.__file__}:
                return None
            if event == ("line" if frame.f_code.co_filename in lines else "call"):
                left -= 1
                if left == -1:
                    raise KeyboardInterrupt
            return interrupt

        before = sys.gettrace()
        sys.settrace(interrupt)
        try:
            files.write_whole(at, b"{}\n")
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(before)
        files.remove_rooms()
        assert list(tmp_path.iterdir()) == [at], line
        assert at.read_bytes() in (OLD, b"{}\n"), line
        is_written |= at.read_bytes() != OLD
        if left >= 0:  # it ended before that line
            break
    assert line > 30 and is_written


def test_ctrl_c_while_the_program_is_loaded_leaves_no_traceback() -> None:
    """From the first module that `main` loads; of what is Python's own before that, nobody here can tell the end."""
    chance = random.Random(f"loading{SEED}")
    for _ in range(COUNT):
        with subprocess.Popen(
            [sys.executable, "-c", FIRST, "data", "inspect", "--help"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONUNBUFFERED": ""},
        ) as process:
            assert process.stderr is not None
            assert process.stderr.read(1) == b"!"
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(chance.uniform(0.0, 0.04))
            process.send_signal(signal.SIGINT)
            sent = time.monotonic()
            said = process.stderr.read().decode()
            code = process.wait()
            note(seconds=time.monotonic() - sent)
        assert "Traceback" not in said, said
        assert (code, "Interrupted" in said) in ((128 + signal.SIGINT, True), (0, False)), said
