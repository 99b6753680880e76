"""A campaign on a Dask cluster, whose workers come and go, gives what processes of this machine give."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from benchmarks.dask_cluster import Cluster
from jointid.campaigns.cases import Outcome
from jointid.campaigns.engines import DaskCluster, LocalProcesses
from jointid.campaigns.folder import read_results
from jointid.campaigns.run import run_cases
from jointid.campaigns.store import open_database
from jointid.common.errors import MethodError
from tests.campaigns.work import POISON, carry, cases, ends

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not find_spec("distributed"), reason="distributed is not installed"),
    pytest.mark.filterwarnings("default"),  # Dask's own
]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with contextlib.ExitStack() as stack:
        yield Cluster(tmp_path, stack)


def test_workers_that_come_and_go_give_what_processes_give(cluster: Cluster, tmp_path: Path) -> None:
    log, count = tmp_path / "log", 200
    first, _ = cluster.add_worker(), cluster.add_worker()

    def come_and_go() -> None:
        while len(ends(log)) < count // 4:
            time.sleep(0.01)
        first.kill()
        cluster.add_worker()

    mover = threading.Thread(target=come_and_go)
    mover.start()
    for name in ("dask", "here"):
        (tmp_path / name).mkdir()
    with open_database(tmp_path / "dask") as database:
        run_cases(lambda: cases(count, log), DaskCluster(cluster.address), database, carry=carry)
    mover.join()
    with open_database(tmp_path / "here") as database:
        run_cases(lambda: cases(count, log), LocalProcesses(2), database, carry=carry)
    by_dask, here = (read_results(tmp_path / name) for name in ("dask", "here"))
    assert [row.text() for row in by_dask.rows] == [row.text() for row in here.rows]
    assert len(here.rows) == count


def test_a_poisonous_case_is_set_aside(cluster: Cluster, tmp_path: Path) -> None:
    log = tmp_path / "log"
    for _ in range(2):
        cluster.add_worker(nanny=True)
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(8, log, {3: POISON}), DaskCluster(cluster.address), database, carry=carry)
    results = read_results(tmp_path)
    assert results.counts()[Outcome.IDENTIFIED] == 7
    assert [row.joint for row in results.rows if row.outcome is Outcome.SET_ASIDE] == ["axis 3"]


def test_a_scheduler_that_does_not_answer_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jointid.campaigns.engines._PATIENCE", 0.5)
    with (
        open_database(tmp_path) as database,
        pytest.raises(MethodError, match=r"^No Dask scheduler answers at tcp://127.0.0.1:9 \("),
    ):
        run_cases(lambda: cases(1, tmp_path / "log"), DaskCluster("tcp://127.0.0.1:9"), database, carry=carry)
