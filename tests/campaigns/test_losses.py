"""Nothing finished is lost or made twice: killed workers and clients, poison, torn files, full disks."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from jointid.campaigns.cases import Outcome, Row
from jointid.campaigns.engines import LocalProcesses, Workers
from jointid.campaigns.folder import read_results
from jointid.campaigns.run import run_cases
from jointid.campaigns.shards import Shard, open_shard, read_shards
from jointid.campaigns.store import open_database, require_local_disk
from jointid.common.errors import RecordError
from tests.campaigns.conftest import FLEET
from tests.campaigns.work import POISON, SLOW, carry, cases, ends, last_workers
from tests.losses.runs import COUNT, SEED

ROOT = Path(__file__).resolve().parents[2]


def test_a_poisonous_case_is_set_aside_and_named_and_no_other_is_blamed(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with open_database(tmp_path) as database:
        ran = run_cases(lambda: cases(12, log, {3: POISON}), LocalProcesses(2), database, carry=carry)
    results = read_results(tmp_path)
    assert ran.made[Outcome.SET_ASIDE] == 1
    assert results.counts()[Outcome.IDENTIFIED] == 11
    (aside,) = (row for row in results.rows if row.outcome is Outcome.SET_ASIDE)
    assert aside.joint == "axis 3"
    assert aside.sentence.startswith("2 workers died of ")
    assert len(set(ends(log))) == 11


def test_a_worker_that_is_killed_costs_no_result(tmp_path: Path) -> None:
    log, killed = tmp_path / "log", threading.Event()

    def kill_one() -> None:
        while not ends(log):
            time.sleep(0.01)
        os.kill(last_workers(log)[-1], signal.SIGKILL)
        killed.set()

    killer = threading.Thread(target=kill_one)
    killer.start()
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(40, log), LocalProcesses(2), database, carry=carry)
    killer.join()
    assert killed.is_set()
    assert read_results(tmp_path).counts()[Outcome.IDENTIFIED] == 40


@pytest.mark.hostile
@pytest.mark.parametrize("shard", ["", "1/1"])
def test_a_client_or_a_shard_that_is_killed_loses_nothing_and_makes_nothing_twice(tmp_path: Path, shard: str) -> None:
    """`JOINTID_ATTACKS=100` kills it that many times."""
    count, log, dice = 60 * COUNT, tmp_path / "log", random.Random(f"{shard}{SEED}")
    command = [sys.executable, "-m", "tests.campaigns.work", str(tmp_path), str(log), str(count), shard]
    finished = set[str]()
    for _ in range(COUNT):
        before = len(ends(log))
        with subprocess.Popen(command, cwd=ROOT, start_new_session=True) as client:
            began = time.monotonic()
            while len(ends(log)) == before and time.monotonic() - began < 60 and client.poll() is None:
                time.sleep(0.01)
            time.sleep(dice.uniform(0.0, 0.2))
            client.kill()
        now = {row.content_hash for row in read_results(tmp_path).rows}
        assert finished <= now, "a result was lost"
        assert not finished & set(ends(log)[before:]), "a finished case was made again"
        finished = now
        wait_for_silence(log)
    subprocess.run(command, cwd=ROOT, check=True)
    results = read_results(tmp_path)
    assert results.counts()[Outcome.IDENTIFIED] == results.cases == count


@pytest.mark.hostile
@pytest.mark.skipif(sys.platform != "linux", reason="a server that forks")
def test_an_end_while_the_first_worker_starts_leaves_no_traceback_and_no_folder(place: Path) -> None:
    """Ctrl-C of a terminal, which all processes receive, SIGTERM, kill -9 of the client and of all of them."""
    (place / "campaign.toml").write_text(FLEET)
    (place / "temporary").mkdir()
    command = [sys.executable, "-c", "from jointid.apps.cli import main; main()", "campaign", "run", "campaign.toml"]
    dice = random.Random(f"first worker{SEED}")
    for turn in range(max(COUNT // 2, 4)):
        with subprocess.Popen(
            [*command, "--out", f"out {turn}", "-q"], cwd=place, start_new_session=True, stderr=subprocess.PIPE,
            env={**os.environ, "TMPDIR": str(place / "temporary")},
        ) as client:  # fmt: skip
            while "forkserver" not in children_of(client.pid) and client.poll() is None:
                time.sleep(0.01)
            time.sleep(0.2 + dice.uniform(0.0, 2.0))
            kill, send = ENDS[turn % len(ENDS)]
            send(client.pid, kill)
            assert client.stderr is not None
            said = client.stderr.read().decode()  # which ends with the last process
        assert "Traceback" not in said, said
        assert client.returncode in (0, -kill, 128 + kill), said
        assert not any((place / "temporary").iterdir())


ENDS = ((signal.SIGKILL, os.killpg), (signal.SIGINT, os.killpg), (signal.SIGTERM, os.kill), (signal.SIGKILL, os.kill))


def children_of(process: int) -> str:
    """Return what a process's children were started with."""
    said = ""
    with contextlib.suppress(OSError):  # one has ended
        for child in Path(f"/proc/{process}/task/{process}/children").read_text().split():
            said += Path(f"/proc/{child}/cmdline").read_text()
    return said


def wait_for_silence(log: Path) -> None:
    """Wait until the workers of a client that was killed have ended, which they are to do by themselves."""
    for _ in range(100):
        before = len(ends(log))
        time.sleep(0.1)
        if len(ends(log)) == before:
            return
    pytest.fail("the workers of a killed client go on")


@pytest.mark.hostile
def test_workers_that_are_killed_at_random_moments_cost_no_result(tmp_path: Path) -> None:
    """`JOINTID_ATTACKS=100` kills that many; none of the cases is to blame, and none is set aside."""
    count, log, dice, over = 200 * COUNT, tmp_path / "log", random.Random(SEED), threading.Event()
    kills = 0

    def kill_some() -> None:
        nonlocal kills
        while kills < COUNT and not over.is_set():
            time.sleep(dice.uniform(0.05, 0.5))
            with contextlib.suppress(ProcessLookupError, IndexError):  # it has ended, or none has begun
                os.kill(last_workers(log)[-1], signal.SIGKILL)
                kills += 1

    killer = threading.Thread(target=kill_some)
    killer.start()
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(count, log), LocalProcesses(2), database, carry=carry)
    over.set()
    killer.join()
    results = read_results(tmp_path)
    assert kills > COUNT // 2
    assert results.counts()[Outcome.IDENTIFIED] == results.cases == count, "a case was blamed for what it did not do"


class Breaking(LocalProcesses):
    """Processes that die before they take a case, the first so many times."""

    left = 0

    @contextlib.contextmanager
    def open(self, workers: int | None = None) -> Iterator[Workers]:
        with super().open(workers) as ready:
            Breaking.left -= 1
            yield Workers(Broken(), ready.capacity) if Breaking.left >= 0 else ready


class Broken(Executor):
    def submit(self, *_: object, **__: object) -> Future:  # type: ignore[override, type-arg]
        raise BrokenProcessPool


def test_workers_that_die_with_nothing_to_do_end_no_campaign(tmp_path: Path) -> None:
    log, Breaking.left = tmp_path / "log", 3
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(10, log), Breaking(1), database, carry=carry)
    assert read_results(tmp_path).counts()[Outcome.IDENTIFIED] == 10
    Breaking.left = 100
    (tmp_path / "other").mkdir()
    with open_database(tmp_path / "other") as database, pytest.raises(RecordError, match=r"^Workers die before they"):
        run_cases(lambda: cases(10, log), Breaking(1), database, carry=carry)


def test_a_client_that_is_interrupted_ends_at_once_and_keeps_what_there_is(tmp_path: Path) -> None:
    log = tmp_path / "log"

    def interrupt(message: str) -> None:
        raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), open_database(tmp_path) as database:
        keep = database.add

        def add(rows: Sequence[Row]) -> None:
            keep(rows)
            interrupt("")

        database.add = add  # type: ignore[method-assign]
        run_cases(lambda: cases(8, log, dict.fromkeys(range(1, 8), SLOW)), LocalProcesses(2), database, carry=carry)
    assert time.monotonic() - began < 8 * 2
    assert len(read_results(tmp_path).rows) == 1


def test_two_clients_are_not_at_work_in_one_folder(tmp_path: Path) -> None:
    with (
        open_database(tmp_path),
        pytest.raises(RecordError, match=r"^Another campaign is at work in .*; wait"),
        open_database(tmp_path),
    ):
        pass
    with open_database(tmp_path):
        pass


def test_a_torn_line_of_a_shard_is_made_again(tmp_path: Path) -> None:
    log, part = tmp_path / "log", Shard(1, 1)
    with open_shard(tmp_path, part) as results:
        run_cases(lambda: cases(4, log), LocalProcesses(1), results, has=part.has, carry=carry)
    path = part.path(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-40])
    assert len(read_results(tmp_path).rows) == 3
    with open_shard(tmp_path, part) as results:
        ran = run_cases(lambda: cases(4, log), LocalProcesses(1), results, has=part.has, carry=carry)
    assert (ran.found, sum(ran.made.values())) == (3, 1)
    name, count, found = read_shards(tmp_path)
    assert (name, count, len(found)) == ("", 4, 4)
    assert len(ends(log)) == 5


def test_a_list_that_grows_is_kept_once_and_what_changed(tmp_path: Path) -> None:
    hashes, part = [f"{n:064x}" for n in range(1000)], Shard(1, 1)
    path, sizes = part.path(tmp_path), []
    for night in (hashes[:900], hashes[::-1], hashes, hashes[5:]):
        with open_shard(tmp_path, part) as results:
            assert results.list_cases("fleet", night) == len(night)
            assert results.list_cases("fleet", night) == len(night)
        sizes.append(path.stat().st_size)
        assert read_shards(tmp_path)[:2] == ("fleet", len(night))
    assert sizes[1] - sizes[0] < 0.2 * sizes[0]
    assert sizes[2] == sizes[1], "in another order it is the same list"
    assert sizes[3] - sizes[2] < 1000
    torn = path.read_bytes()[:-10]
    path.write_bytes(torn)
    assert read_shards(tmp_path)[1] == 1000, "the list before a torn change"
    with open_shard(tmp_path, part) as results:
        results.list_cases("other name", hashes[5:])
    assert read_shards(tmp_path)[:2] == ("other name", 995)
    with open_shard(tmp_path, part) as results:
        results.list_cases("fleet", ["0" * 64])
        results.add([Row("f" * 64, "a", "a.npy", "", (), Outcome.REFUSED, "Of before.", "")])
    assert read_shards(tmp_path) == ("fleet", 1, []), "rows of cases that are no longer listed are not shown"


def test_a_full_disk_is_a_sentence_and_keeps_what_is_finished(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with open_database(tmp_path) as database:
        run_cases(lambda: cases(2, log), LocalProcesses(1), database, carry=carry)
        database._connection.execute("PRAGMA max_page_count = 1")
        long = dict.fromkeys(range(2, 40), "x" * 20000)
        with pytest.raises(RecordError, match=r"full\); what is finished is kept: free space there"):
            run_cases(lambda: cases(40, log, long), LocalProcesses(1), database, carry=carry)
    assert len(read_results(tmp_path).rows) >= 2


def test_a_full_disk_of_a_shard_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with (
        pytest.raises(RecordError, match=r"no space left on device\); what is finished is kept"),
        open_shard(tmp_path, Shard(1, 1)) as results,
    ):
        results.list_cases("", ["00"])
        monkeypatch.setattr(os, "write", refuse)
        results.list_cases("", ["01"])
    assert read_shards(tmp_path)[1] == 1


MOUNTS = """\
22 1 0:21 / / rw,relatime shared:1 - overlay overlay rw
36 22 0:40 / /data rw - nfs4 server:/data rw
37 36 8:1 / /data/local\\040disk rw - ext4 /dev/sda1 rw
38 22 0:41 / /mnt/me rw - fuse.sshfs me@there: rw
"""


@pytest.mark.skipif(sys.platform == "win32", reason="paths")
@pytest.mark.parametrize(
    ("folder", "kind"), [("/data/a", "nfs4"), ("/data", "nfs4"), ("/mnt/me/a", "fuse.sshfs"), ("/database", ""),
                         ("/data/local disk/a", ""), ("/mnt/merry", "")],
)  # fmt: skip
def test_a_disk_in_a_network_is_refused(folder: str, kind: str) -> None:
    if not kind:
        require_local_disk(Path(folder), MOUNTS)
        return
    with pytest.raises(RecordError, match=rf"^{folder} is on a disk in a network \({kind}\), .* --shard 1/4\.$"):
        require_local_disk(Path(folder), MOUNTS)
