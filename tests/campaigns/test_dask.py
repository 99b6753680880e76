"""A campaign on a Dask cluster, whose workers come and go, gives what processes of this machine give."""

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from jointid.campaigns.run import Engine, Outcome, dask_cluster
from jointid.common.errors import JointidError, MethodError
from tests.campaigns.work import POISON, TWO, ends, results, run_all

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not find_spec("distributed"), reason="distributed is not installed"),
    pytest.mark.filterwarnings("default"),  # Dask's own
]


ROOT = Path(__file__).resolve().parents[2]


class Cluster:
    """A scheduler and workers, each a process, as `dask scheduler` and `dask worker` start them."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack) -> None:
        self._file, self._stack = folder / "scheduler.json", stack
        place = ("--host", "tcp://127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0")
        self.scheduler = self.start("dask_scheduler", *place)
        while not self._file.exists() or not self._file.stat().st_size:  # it is made, and then written
            time.sleep(0.05)
        self.address: str = json.loads(self._file.read_text())["address"]

    def start(self, program: str, *options: str) -> subprocess.Popen[bytes]:
        """Start a program of Dask's, which ends with the stack."""
        command = [sys.executable, "-m", f"distributed.cli.{program}", "--scheduler-file", str(self._file), *options]
        few = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}  # workers take seconds to start anew
        process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL, env=os.environ | few)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def add_worker(self, *options: str, nanny: bool = False) -> subprocess.Popen[bytes]:
        """Start a worker of one thread; with a nanny, which starts it anew when it dies."""
        kind = "--nanny" if nanny else "--no-nanny"
        return self.start("dask_worker", "--nthreads", "1", kind, "--dashboard-address", "127.0.0.1:0", *options)


def dask(address: str) -> Engine:
    return partial(dask_cluster, address)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with contextlib.ExitStack() as stack:
        yield Cluster(tmp_path, stack)


def test_a_poisonous_case_is_set_aside(cluster: Cluster, log: Path, tmp_path: Path) -> None:
    for _ in range(2):
        cluster.add_worker(nanny=True)
    kinds = {3: POISON}
    made = run_all(tmp_path / "out", log, 8, dask(cluster.address), kinds)
    assert made[Outcome.IDENTIFIED] == 7
    aside = [row.joint for row in results(tmp_path / "out", log, 8, kinds) if row.outcome is Outcome.SET_ASIDE]
    assert aside == ["axis 3"]


def test_a_scheduler_that_does_not_answer_is_refused(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jointid.campaigns.run._PATIENCE", 0.5)
    with pytest.raises(MethodError):
        run_all(tmp_path / "out", log, 1, dask("tcp://127.0.0.1:9"))


def test_a_scheduler_that_is_killed_costs_no_result(cluster: Cluster, log: Path, tmp_path: Path) -> None:
    """The same command goes on, here on this machine, and makes nothing twice that was kept."""
    path, count = tmp_path / "out", 40
    cluster.add_worker()

    def kill() -> None:
        while not ends(log):
            time.sleep(0.01)
        cluster.scheduler.kill()

    killer = threading.Thread(target=kill)
    killer.start()
    with contextlib.suppress(JointidError):
        run_all(path, log, count, dask(cluster.address))
    killer.join()
    kept, before = {row.content_hash for row in results(path, log, count)}, len(ends(log))
    run_all(path, log, count, TWO)
    assert kept <= {row.content_hash for row in results(path, log, count)}, "a result was lost"
    assert not kept & set(ends(log)[before:]), "a finished case was made again"
    run_all(tmp_path / "here", log, count, TWO)
    here = results(tmp_path / "here", log, count)
    assert results(path, log, count) == here and len(here) == count
