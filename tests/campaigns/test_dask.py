"""A campaign on a Dask cluster, whose workers come and go, gives what processes of this machine give."""

from __future__ import annotations

import contextlib
import random
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from jointid.campaigns.cases import Outcome
from jointid.campaigns.engines import DaskCluster, LocalProcesses
from jointid.campaigns.folder import read_results
from jointid.campaigns.run import run_cases
from jointid.campaigns.store import open_database
from jointid.common.errors import JointidError, MethodError, RecordError
from tests.campaigns.dask_cluster import ROOT, Cluster
from tests.campaigns.work import POISON, carry, cases, ends
from tests.losses.runs import COUNT, SEED

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


def test_a_worker_of_another_version_refuses_in_a_sentence(cluster: Cluster, tmp_path: Path) -> None:
    (tmp_path / "other.py").write_text("import jointid.campaigns.run\njointid.campaigns.run.__version__ = '0.0.1'\n")
    cluster.add_worker("--preload", str(tmp_path / "other.py"))
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(2, tmp_path / "log"), DaskCluster(cluster.address), database)
    rows = read_results(tmp_path).rows
    assert [row.outcome for row in rows] == [Outcome.REFUSED] * 2
    assert "and the worker has 0.0.1; install the same on both" in rows[0].sentence


@pytest.mark.skipif(not shutil.which("openssl"), reason="a certificate")
def test_a_cluster_of_ones_own_certificate_takes_cases(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The settings of the documentation; whoever has no certificate is not let in."""
    made = "openssl req -x509 -newkey rsa:2048 -nodes -keyout mine.key -out mine.pem -days 2 -subj /CN=jointid"
    subprocess.run(shlex.split(made), cwd=tmp_path, check=True, capture_output=True)
    settings = {"ca-file": "mine.pem"}
    for who in ("scheduler", "worker", "client"):
        settings |= {f"{who}.cert": "mine.pem", f"{who}.key": "mine.key"}
    settings = {f"distributed.comm.tls.{key}": str(tmp_path / name) for key, name in settings.items()}
    for key, path in settings.items():
        name = key.upper().replace(".", "__").replace("-", "_")
        monkeypatch.setenv(f"DASK_{name}", path)
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION", "True")
    dask = pytest.importorskip("dask")
    with contextlib.ExitStack() as stack, open_database(tmp_path) as database:
        cluster = Cluster(tmp_path, stack, "tls://127.0.0.1:0")
        cluster.add_worker()
        with dask.config.set({**settings, "distributed.comm.require-encryption": True}):
            ran = run_cases(lambda: cases(3, tmp_path / "log"), DaskCluster(cluster.address), database, carry=carry)
        assert ran.made[Outcome.IDENTIFIED] == 3
        monkeypatch.setattr("jointid.campaigns.engines._PATIENCE", 1.0)
        plain = DaskCluster(cluster.address.replace("tls", "tcp"))
        with pytest.raises(MethodError, match="No Dask scheduler answers"):
            run_cases(lambda: cases(4, tmp_path / "log"), plain, database, carry=carry)


@pytest.mark.hostile
def test_a_second_client_is_refused_and_goes_on_where_the_first_is_killed(cluster: Cluster, tmp_path: Path) -> None:
    """Cases of the killed client may still be under way on the cluster; `JOINTID_ATTACKS=60` kills ten."""
    log, dice = tmp_path / "log", random.Random(f"clients{SEED}")
    for _ in range(2):
        cluster.add_worker()
    for count in range(200, 200 * max(COUNT // 6, 1) + 1, 200):
        program = ["-m", "tests.campaigns.work", str(tmp_path), str(log), str(count), "", cluster.address]
        begin = len(ends(log))
        with subprocess.Popen([sys.executable, *program], cwd=ROOT) as first:
            while len(ends(log)) == begin:
                time.sleep(0.01)
            with pytest.raises(RecordError, match=r"^Another campaign is at work in .*; wait"):
                run_by_dask(tmp_path, log, count, cluster)
            time.sleep(dice.uniform(0.0, 0.3))
            assert first.poll() is None
            first.kill()
        kept, before = {row.content_hash for row in read_results(tmp_path).rows}, len(ends(log))
        run_by_dask(tmp_path, log, count, cluster)
        results = read_results(tmp_path)
        assert results.counts()[Outcome.IDENTIFIED] == results.cases == count, "a result was lost"
        assert not kept & set(ends(log)[before:]), "a finished case was made again"


def run_by_dask(folder: Path, log: Path, count: int, cluster: Cluster) -> None:
    with open_database(folder) as database:
        run_cases(lambda: cases(count, log), DaskCluster(cluster.address), database, carry=carry)


@pytest.mark.hostile
def test_nothing_is_lost_or_kept_twice_at_any_moment(
    cluster: Cluster, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Workers and schedulers are killed; `JOINTID_ATTACKS=50` kills that many. The same command goes on each time."""
    log, dice, count, workers = tmp_path / "log", random.Random(f"dask{SEED}"), 40 * COUNT, [cluster.add_worker()]
    sentences, over = list[str](), threading.Event()
    monkeypatch.setattr("jointid.campaigns.engines._PATIENCE", 120.0)  # of a machine that is busy

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
        with open_database(tmp_path) as database:
            kept, before = {row.content_hash for row in read_results(tmp_path).rows}, len(ends(log))
            try:
                run_cases(partial(cases, 40 * (turn + 1), log), DaskCluster(cluster.address), database, carry=carry)
            except JointidError as error:
                sentences.append(str(error))
        over.set()
        killer.join()
        over.clear()
        assert kept <= {row.content_hash for row in read_results(tmp_path).rows}, "a result was lost"
        assert not kept & set(ends(log)[before:]), "a finished case was made again"
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(count, log), DaskCluster(cluster.address), database, carry=carry)
    results = read_results(tmp_path)
    assert results.counts()[Outcome.IDENTIFIED] == results.cases == count
    assert all(
        re.fullmatch(r"The Dask scheduler at .* answers no more; start it again, .*kept\.", s) for s in sentences
    )
    assert "Traceback" not in capfd.readouterr().err
