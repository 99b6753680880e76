"""Long work as a user sees it: bars on a terminal, a line now and then elsewhere, nothing where none is wanted."""

import io
import signal
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest
from rich.console import Console

from jointid.apps.cli import console
from jointid.apps.cli.console import Bars
from jointid.common.messages import Detail, follow, ignore_progress


def test_work_tells_how_far_it_is_each_second(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = count()
    monkeypatch.setattr("time.monotonic", lambda: 0.25 * next(seconds))
    said: list[str] = []
    assert list(follow(range(35), said.append, "bootstrapping", 35, "draws")) == list(range(35))
    assert [isinstance(one, Detail) and one.pace for one in said] == [True] * 8
    assert said[0] == "bootstrapping: 4 of 35 draws"


def test_a_terminal_shows_the_last_line_and_nothing_is_left_behind() -> None:
    file = io.StringIO()
    bars = Bars(Console(file=file, force_terminal=True, width=110))
    told = (Detail("bootstrapping: 12 of 40 draws", pace=True), f"a sentence {'[of a file] ' * 12}")
    for line in ("a stage", *told, Detail("iteration 3")):
        bars(line)
    bars.clear()
    shown = " ".join(file.getvalue().split())
    assert all(" ".join(line.split()) in shown for line in told) and "iteration" not in shown
    assert file.getvalue().endswith("\x1b[2K"), "the line is erased"


@pytest.mark.parametrize("terminal", [True, False])
def test_who_listens_depends_on_the_terminal(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    assert console.listen(quiet=True) is ignore_progress
    assert isinstance(console.listen(quiet=False), Bars) == terminal


PROGRAM = """
import signal, sys, time
from pathlib import Path
from jointid.apps.cli import main
from jointid.common.files import beside

signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it

def end(*_, **__):
    with beside(Path("o.json")) as fresh:
        fresh.write_text("half")
        signal.raise_signal(int(sys.argv[2]))

if sys.argv[1] != "loading":
    from jointid.apps.cli import app
    callback = type("Callback", (), {"__del__": end})
    app.app = end if sys.argv[1] == "loaded" else lambda *_, **__: callback() and time.sleep(1)
else:
    sys.addaudithook(lambda event, words: words[:1] == ("jointid.apps.cli.app",) and signal.raise_signal(signal.SIGINT))
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no process can send itself these signals")
@pytest.mark.parametrize(("when", "number"), [("loading", 2), ("loaded", 2), ("swallowed", 2), ("loaded", 15)])
def test_a_signal_ends_the_program_without_a_traceback(when: str, number: int, tmp_path: Path) -> None:
    words = [sys.executable, "-c", PROGRAM, when, str(number)]
    ran = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == (-number if when == "loading" else 128 + number) and "Traceback" not in ran.stderr
    assert number == signal.SIGTERM or list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="a shell")
@pytest.mark.parametrize(
    ("ending", "code"), [("| true", 0), ("2>&1 | true", 0), (">&-", 0), (">&- 2>&-", 0), (">/dev/full", 2)]
)
def test_an_output_that_takes_nothing_costs_no_file(ending: str, code: int, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text("t,i\n" + "".join(f"{i},{i % 7}\n" for i in range(400)), encoding="utf-8")
    program = f"{sys.executable} -c 'from jointid.apps.cli import main; main()'"
    line = f"set -o pipefail; {program} inspect table.csv --json o.json {ending}"
    ended = subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, check=False)
    assert ended.returncode == code and b"Traceback" not in ended.stderr
    assert (tmp_path / "o.json").read_bytes().rstrip().endswith(b"}")
