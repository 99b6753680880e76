"""A campaign on a Dask cluster, whose workers come and go, gives what processes of this machine give."""

from __future__ import annotations

import contextlib
import random
import threading
import time
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from jointid.campaigns.run import Engine, dask_cluster
from jointid.campaigns.store import Outcome
from jointid.common.errors import JointidError, MethodError
from tests.campaigns.dask_cluster import Cluster
from tests.campaigns.work import POISON, TWO, ends, results, run_all
from tests.losses.runs import COUNT, SEED

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not find_spec("distributed"), reason="distributed is not installed"),
    pytest.mark.filterwarnings("default"),  # Dask's own
]


def dask(address: str) -> Engine:
    return partial(dask_cluster, address)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with contextlib.ExitStack() as stack:
        yield Cluster(tmp_path, stack)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "log"


def test_workers_that_come_and_go_give_what_processes_give(cluster: Cluster, log: Path, tmp_path: Path) -> None:
    count = 200
    first, _ = cluster.add_worker(), cluster.add_worker()

    def come_and_go() -> None:
        while len(ends(log)) < count // 4:
            time.sleep(0.01)
        first.kill()
        cluster.add_worker()

    mover = threading.Thread(target=come_and_go)
    mover.start()
    run_all(tmp_path / "dask", log, count, dask(cluster.address))
    mover.join()
    run_all(tmp_path / "here", log, count, TWO)
    here = results(tmp_path / "here", log, count)
    assert results(tmp_path / "dask", log, count) == here
    assert len(here) == count


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


@pytest.mark.hostile
def test_nothing_is_lost_or_kept_twice_at_any_moment(
    cluster: Cluster, log: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Workers and schedulers are killed; `JOINTID_ATTACKS=50` kills that many. The same command goes on each time."""
    dice, count, workers = random.Random(f"dask{SEED}"), 40 * COUNT, [cluster.add_worker()]
    path, over = tmp_path / "out", threading.Event()
    monkeypatch.setattr("jointid.campaigns.run._PATIENCE", 120.0)  # of a machine that is busy

    def attack() -> None:
        begin = len(ends(log))
        while len(ends(log)) <= begin and not over.wait(0.01):
            pass
        time.sleep(dice.uniform(0.0, 0.3))
        if turn % 2:
            workers.pop().kill()
        else:
            cluster.scheduler.kill()
            cluster.scheduler.wait()
            workers.pop().wait()  # a worker ends with its scheduler
            time.sleep(dice.uniform(0.0, 3.0))
            cluster.scheduler = cluster.start_scheduler(cluster.address)
        workers.append(cluster.add_worker())

    for turn in range(COUNT):
        killer = threading.Thread(target=attack)
        killer.start()
        kept, before = {row.content_hash for row in results(path, log, count)}, len(ends(log))
        with contextlib.suppress(JointidError):
            run_all(path, log, 40 * (turn + 1), dask(cluster.address))
        over.set()
        killer.join()
        over.clear()
        assert kept <= {row.content_hash for row in results(path, log, count)}, "a result was lost"
        assert not kept & set(ends(log)[before:]), "a finished case was made again"
    run_all(path, log, count, dask(cluster.address))
    assert len(results(path, log, count)) == count
    assert "Traceback" not in capfd.readouterr().err
