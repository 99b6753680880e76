"""Work beside other work gives the same result, the same error, and is done again where its process dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jointid.common.errors import RecordError
from jointid.common.parallel import Aside


def test_it_runs_in_another_process() -> None:
    here = os.getpid()
    assert (Aside(os.getpid).result() == here) is (sys.platform != "linux" or (os.cpu_count() or 1) < 2)


def test_an_error_is_raised_where_the_result_is_asked_for() -> None:
    def fail() -> int:
        raise RecordError("no such record")

    aside = Aside(fail)
    with pytest.raises(RecordError):
        aside.result()


def test_a_process_that_dies_leaves_the_work_to_this_one() -> None:
    here = os.getpid()

    def die() -> str:
        if os.getpid() != here:
            os._exit(1)
        return "done here"

    assert Aside(die).result() == "done here"


_KILLED = """
import os, signal, sys, time
from jointid.common.parallel import Aside

started, ready = os.pipe()
aside = Aside(lambda: (os.write(ready, str(os.getpid()).encode()), time.sleep(600)))
open(sys.argv[1], "wb").write(os.read(started, 20))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has processes that are copies")
def test_it_ends_with_the_process_that_began_it_however_that_ends(tmp_path: Path) -> None:
    """A page that cancels a run kills its process, and nothing may be left at work."""
    told = tmp_path / "pid"
    ended = subprocess.run([sys.executable, "-c", _KILLED, str(told)], stdout=subprocess.DEVNULL, check=False)
    assert ended.returncode == -signal.SIGKILL
    pid = int(told.read_text())
    for _ in range(300):
        if not _is_at_work(pid):
            return
        time.sleep(0.1)
    os.kill(pid, signal.SIGKILL)
    raise AssertionError("it is still there")


def _is_at_work(pid: int) -> bool:
    """Whether a process has not ended; the number of one that has stays while nobody asks how."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return False
    return "\nState:\tZ" not in status
