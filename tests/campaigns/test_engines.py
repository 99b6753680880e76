"""Processes of this machine as workers."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, util
from pathlib import Path

import numpy as np
import pytest

from jointid.campaigns.engines import LocalProcesses
from jointid.campaigns.fork_server import IS_SERVER

if sys.platform != "win32":
    import resource


def open_workers() -> None:
    with LocalProcesses(1).open() as workers:
        assert workers.executor.submit(signal.getsignal, signal.SIGINT).result() == signal.SIG_IGN


@pytest.mark.skipif(sys.platform != "linux", reason="no server forks workers there")
def test_other_workers_of_the_program_hear_an_interrupt() -> None:
    open_workers()
    with ProcessPoolExecutor(1, get_context("forkserver")) as own:
        assert signal.SIGINT not in own.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="no server forks workers there")
def test_a_campaign_in_a_child_process_leaves_the_folder_of_its_parent() -> None:
    folder = Path(util.get_temp_dir())
    before = set(folder.iterdir())
    child = get_context("spawn").Process(target=open_workers)
    child.start()
    child.join()
    assert child.exitcode == 0
    for _ in range(200):  # until its server has ended
        if (after := set(folder.iterdir())) == before:
            break
        time.sleep(0.05)
    assert after == before


def faults(turns: int) -> int:
    """Return how many pages the system gave this process while it took and freed the same 8 MB again and again."""
    before = 0
    for turn in range(turns + 1):
        if turn == 1:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        blocks = [np.ones(2**18) for _ in range(4)]
        del blocks
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="no server forks workers there")
def test_modules_that_the_program_preloads_are_kept(tmp_path: Path) -> None:
    (tmp_path / "heavy.py").write_text("import os\nloaded_by = os.getpid()\n")
    (tmp_path / "program.py").write_text(PRELOADING)
    path = os.pathsep.join(map(str, (tmp_path, Path(__file__).resolve().parents[2])))
    said = subprocess.run(
        [sys.executable, "program.py"], cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True,
        text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert said[0] == said[1], "the server loaded it, and not the worker"
    assert said[2:] == ["deaf", "hears"]


@pytest.mark.parametrize(("error", "is_said"), [("EOFError", False), ("RuntimeError", True)])
def test_the_server_says_nothing_but_what_a_program_without_a_guard_does_wrong(error: str, is_said: bool) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", f"import jointid.campaigns.fork_server; raise {error}"],
        env={**os.environ, IS_SERVER: "1"}, capture_output=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 1
    assert (error in ended.stderr.decode()) is is_said


PRELOADING = """
import multiprocessing, os, signal
from concurrent.futures import ProcessPoolExecutor
from jointid.campaigns.engines import LocalProcesses

def look():
    import heavy
    return heavy.loaded_by, os.getppid(), signal.getsignal(signal.SIGINT) == signal.SIG_IGN

if __name__ == "__main__":
    multiprocessing.set_forkserver_preload(["heavy"])
    with LocalProcesses(1).open() as workers:
        by, server, deaf = workers.executor.submit(look).result()
    with ProcessPoolExecutor(1, multiprocessing.get_context("forkserver")) as own:
        print(by, server, "deaf" if deaf else "hears", "deaf" if own.submit(look).result()[2] else "hears")
"""


@pytest.mark.skipif(sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"), reason="glibc's")
def test_a_worker_keeps_what_a_case_frees_for_the_next() -> None:
    pages = 10 * 2**23 // 4096
    with LocalProcesses(1).open() as workers:
        assert workers.executor.submit(faults, 10).result() < pages / 10
