"""Engines that execute cases, as `concurrent.futures.Executor`.

The default is local processes. Dask or SLURM schedule clusters. SLURM jobs outlive their client, and are found by the
next one: executorlib submits jobs and reads results as files in a shared folder. The cases determine a job's name and
folder, and SLURM's queue shows it, so that a job is known even if the client was killed before writing its number.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePath
from typing import Any, Protocol

from jointid.campaigns.cases import canonical, sha256_of
from jointid.common.errors import MethodError, RecordError, extra
from jointid.common.parallel import BLAS_THREADS, THREADS, cores, end_with_parent

_PATIENCE = 10.0  # s that a scheduler has to answer
_TRIM, _MMAP = -1, -3  # thresholds of glibc's mallopt: free memory is given back, and a block has a mapping of its own
_KEPT, _IN_THE_HEAP = 2**28, 2**25  # bytes; the latter is the most that glibc takes
_POLL = 0.5  # s between looks for the result of a job
_LOOK = 10.0  # s between looks at the queue, for the jobs of an earlier client
_MISSED = 2  # looks in a row that a job is not in the queue and has no result, after which it has died
_SCRIPT = """\
#!/bin/bash
#SBATCH --output=time.out
#SBATCH --job-name={{job_name}}
#SBATCH --chdir={{working_directory}}
#SBATCH --get-user-env=L
{%- if partition %}
#SBATCH --partition={{partition}}
{%- endif %}
#SBATCH --ntasks={{cores}}

{{command}}
"""
"""Of a job; pysqa's own has an empty partition where none is named, which is not SLURM's default one."""
_PRELOADED = ("jointid.campaigns.fork_server", "jointid.campaigns.run")
_CASES = "cases.txt"  # in the folder of a job, the hashes of its cases


@dataclass(frozen=True, slots=True)
class Workers:
    """Available workers.

    Attributes:
        capacity: how many tasks it can work at; of a cluster that is now.
        batch: cases of a task: one, where handing out a task is cheap.
        ahead: tasks under way for each that it works at, so that no worker waits for the next.
        submitted: tasks of an earlier client, which may be under way still: by the hash of each case those of its task.
        require_reachable: raises OSError where no result can come any more.
    """

    executor: Executor
    capacity: Callable[[], int]
    batch: int = 1
    ahead: int = 2
    submitted: Mapping[str, frozenset[str]] = field(default_factory=dict)
    require_reachable: Callable[[], None] = lambda: None


class Engine(Protocol):
    """A source of workers, whose death raises a specific exception."""

    def open(self, workers: int | None = None) -> contextlib.AbstractContextManager[Workers]:
        """Open all or `workers` workers; an exception abandons running cases."""

    def is_death(self, error: BaseException) -> bool:
        """Test whether an exception means a worker's death."""


@dataclass(frozen=True, slots=True)
class LocalProcesses:
    """Local single-threaded processes that end with their parent.

    Attributes:
        workers: how many; one for each core when 0.
    """

    workers: int = 0

    @contextlib.contextmanager
    def open(self, workers: int | None = None) -> Iterator[Workers]:
        """Yield the workers; see `Engine`."""
        # A fork of this process would copy its threads' locks; on Linux a server without threads is forked instead.
        context = multiprocessing.get_context("forkserver" if sys.platform == "linux" else "spawn")
        for name in BLAS_THREADS:  # a worker's libraries read this when they are loaded, before it can say so
            os.environ.setdefault(name, "1")
        if sys.platform == "linux":
            _start_server()
        before = set(multiprocessing.active_children())
        count = workers or self.workers or cores()
        executor = ProcessPoolExecutor(count, context, _Begin())
        try:
            yield Workers(executor, lambda: count)
        except BaseException:
            for process in set(multiprocessing.active_children()) - before:
                process.terminate()
            raise
        finally:
            executor.shutdown(wait=True, cancel_futures=True)

    def is_death(self, error: BaseException) -> bool:
        """Test whether a process died; its siblings are ended, too."""
        return isinstance(error, BrokenExecutor)


@dataclass(frozen=True, slots=True)
class DaskCluster:
    """The changing workers of an existing Dask cluster.

    Dask gives a case of a worker that died to another one, and gives it up after some deaths (its setting
    ``distributed.scheduler.allowed-failures``). It counts the deaths of workers at which a case was only waiting, too:
    who is to blame is found out as for any engine.

    Attributes:
        address: of its scheduler, as tcp://10.0.0.1:8786.
    """

    address: str

    @contextlib.contextmanager
    def open(self, workers: int | None = None) -> Iterator[Workers]:
        """Yield the workers; see `Engine`. The cluster determines their number."""
        distributed = extra("distributed", "cluster", "A Dask cluster")
        for name in (
            "distributed",
            "distributed.client",
            "tornado.application",
        ):  # of a scheduler that is gone they print tracebacks
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            client = distributed.Client(self.address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise MethodError(
                f"No Dask scheduler answers at {self.address} ({type(error).__name__}); start one, and name it as "
                "tcp://10.0.0.1:8786."
            ) from error
        with client:
            executor = client.get_executor(pure=False)  # a case that is tried again is another task
            wait, first = False, client.scheduler_info()["id"]

            def require_reachable() -> None:
                if client.status != "running" or client.scheduler_info()["id"] != first:
                    raise OSError  # another scheduler knows none of these tasks, and Dask does not always say so

            try:
                yield Workers(
                    executor,
                    lambda: sum(
                        int(one["nthreads"]) for one in client.scheduler_info(n_workers=-1)["workers"].values()
                    ),
                    require_reachable=require_reachable,
                )
                wait = True
            except (OSError, RecordError) as error:  # this of cases that are cancelled when the connection is lost
                if isinstance(error, RecordError) and client.status == "running":
                    raise
                raise RecordError(
                    f"The Dask scheduler at {self.address} answers no more; start it again, and give the same command "
                    "again: what is finished is kept."
                ) from error
            finally:
                executor.shutdown(wait=wait)

    def is_death(self, error: BaseException) -> bool:
        """Test whether Dask gave a case up after workers died."""
        killed: type[BaseException] = extra("distributed", "cluster", "A Dask cluster").scheduler.KilledWorker
        return isinstance(error, killed)


@dataclass(frozen=True, slots=True)
class SlurmJobs:
    """SLURM jobs of several cases, submitted by executorlib, with files in a folder.

    The client may leave: a job that is under way goes on, and what it gives is found in the folder when the same
    command is given again. These files are executorlib's, pickled: whoever writes into the folder runs code as the
    client, so that it is the user's alone.

    Attributes:
        folder: for functions and results, which client and nodes share.
        partition: of SLURM; its default one when empty.
    """

    folder: Path
    jobs: int = 64
    batch: int = 100
    partition: str = ""

    @contextlib.contextmanager
    def open(self, workers: int | None = None) -> Iterator[Workers]:
        """Yield the workers; see `Engine`."""
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise RecordError(
                f"{self.folder} cannot be made a folder ({(error.strerror or '').lower()}); name another one by "
                "--shared."
            ) from error
        for module in ("pysqa", "h5py"):  # without which executorlib would quietly run all of it here
            extra(module, "slurm", "SLURM")
        executorlib = extra("executorlib", "slurm", "SLURM")
        resources = {"cores": 1, "submission_template": _SCRIPT} | (
            {"partition": self.partition} if self.partition else {}
        )
        executor = executorlib.SlurmClusterExecutor(
            cache_directory=str(self.folder), resource_dict=resources, wait=False, refresh_rate=_POLL
        )
        jobs = _NamedJobs(executor, self.folder)
        try:
            # Of two jobs with the same case, the later one counts.
            found: dict[str, frozenset[str]] = {}
            for path in sorted(self.folder.glob(f"*/{_CASES}"), key=lambda path: path.stat().st_mtime_ns):
                job = frozenset(path.read_text(encoding="ascii").split())
                found |= dict.fromkeys(job, job)
            yield Workers(jobs, lambda: workers or self.jobs, self.batch, ahead=1, submitted=found)
        finally:
            jobs.shutdown(wait=False)

    def is_death(self, error: BaseException) -> bool:
        """Test whether a job ended without a result."""
        return isinstance(error, RuntimeError) and "terminated without producing output" in str(error)


class _NamedJobs(Executor):
    """executorlib's jobs by name; those of an earlier client are awaited, not repeated."""

    def __init__(self, executor: Any, folder: Path) -> None:
        self._executor, self._folder = executor, folder
        self._earlier: dict[str, tuple[Future[Any], Callable[[], Future[Any]]]] = {}
        self._over, self._watch = threading.Event(), threading.Thread(target=self._wait_for_earlier, daemon=True)

    def submit(self, function: Callable[..., Any], /, *given: Any, **_: Any) -> Future[Any]:
        """Submit a function with a case function and cases."""
        carry, cases = given
        called = getattr(carry, "__qualname__", repr(carry))
        name = sha256_of(canonical([called, sorted(case.content_hash for case in cases)]))
        own = self._folder / name

        def hand_out() -> Future[Any]:
            asked: Future[Any] = self._executor.submit(
                function, *given, resource_dict={"cache_key": name, "cwd": str(own)}
            )
            return asked

        ended = f"{name}_o.h5" in _names_in(self._folder)
        if ended:
            result = self._folder / f"{name}_o.h5"
            with extra("h5py", "slurm", "SLURM").File(result, "r") as file:
                failed = "error" in file
            if failed:
                result.unlink()
        elif (own / _CASES).exists():
            # executorlib looks for a result, and then at the queue: what ends in between it would make again.
            future: Future[Any] = Future()
            self._earlier[name] = future, hand_out
            if not self._watch.is_alive():
                self._watch.start()
            return future
        own.mkdir(exist_ok=True)
        (own / _CASES).write_text("\n".join(case.content_hash for case in cases), encoding="ascii")
        return hand_out()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the jobs running."""
        self._over.set()
        if self._watch.is_alive():
            self._watch.join()
        self._executor.shutdown(wait=wait, cancel_futures=cancel_futures)

    def _wait_for_earlier(self) -> None:
        """Collect the results of an earlier client's jobs."""
        missed, checked = Counter[str](), -_LOOK
        while not self._over.wait(_POLL):
            if time.monotonic() - checked >= _LOOK:
                checked, queue = time.monotonic(), _queue()
                if queue is not None:
                    missed = Counter({name: missed[name] + 1 for name in list(self._earlier) if name not in queue})
            try:
                there = _names_in(self._folder)
            except OSError:  # a disk in a network comes back, or Ctrl-C ends the wait
                continue
            for name, (future, hand_out) in list(self._earlier.items()):
                if f"{name}_o.h5" in there or missed[name] >= _MISSED:
                    del self._earlier[name]
                    hand_out().add_done_callback(partial(_copy_result, future))


def _names_in(folder: Path) -> set[str]:
    """Names in a folder; listing refreshes a network disk's cache."""
    return {path.name for path in folder.iterdir()}


def _queue() -> set[str] | None:
    """Names of queued or running jobs; None if the queue does not answer."""
    try:
        found = subprocess.run(
            ["squeue", "--noheader", "--format", "%Z"],  # noqa: S607 - where SLURM's are, the path says
            capture_output=True, text=True, check=True, timeout=6 * _LOOK,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return {Path(line.strip()).name for line in found.stdout.splitlines()}


def _copy_result(future: Future[Any], found: Future[Any]) -> None:
    if found.cancelled():
        future.cancel()
    elif (error := found.exception()) is not None:
        future.set_exception(error)
    else:
        future.set_result(found.result())


def on_one_core(carry: Callable[[Any], Any], cases: Sequence[Any]) -> list[Any]:
    """Execute cases with one thread."""
    os.environ[THREADS] = "1"
    return [carry(case) for case in cases]


def _start_server() -> None:
    """Start the server that forks workers, deaf to Ctrl-C until their work arrives; see `fork_server`.

    The file of its socket loses its name at once: kill -9 of all processes leaves no file.
    """
    from multiprocessing import forkserver, resource_tracker

    from jointid.campaigns.fork_server import IS_SERVER

    server: Any = forkserver._forkserver
    config = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    forkserver.set_forkserver_preload([*dict.fromkeys((*_PRELOADED, *server._preload_modules))])
    resource_tracker.ensure_running()  # its start unblocks SIGINT
    blocked, folder = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,)), config.get("tempdir")
    os.environ[IS_SERVER] = "1"
    try:
        with tempfile.TemporaryDirectory(prefix="jointid-") as own, _held(own) as short:  # a socket's path is short
            if _can_lose_names(short):
                config["tempdir"] = short
            forkserver.ensure_running()
            if str(server._forkserver_address).startswith(f"{short}/"):
                server._forkserver_address = _hold(server._forkserver_address)
    finally:
        config["tempdir"] = folder
        del os.environ[IS_SERVER]
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _hold(path: str) -> str:
    """Hold a file or folder open, and return a path that leads there without its name."""
    return f"/proc/self/fd/{os.open(path, os.O_PATH | os.O_CLOEXEC)}"


@contextlib.contextmanager
def _held(path: str) -> Iterator[str]:
    """Hold it for a while; see `_hold`."""
    held = _hold(path)
    try:
        yield held
    finally:
        os.close(int(PurePath(held).name))


def _can_lose_names(folder: str) -> bool:
    """Test whether this system connects to a socket without a name."""
    path = f"{folder}/test"
    with socket.socket(socket.AF_UNIX) as listener, socket.socket(socket.AF_UNIX) as client:
        try:
            listener.bind(path)
            listener.listen()
            with _held(path) as held:
                os.unlink(path)  # noqa: PTH108 - a text
                client.connect(held)
        except OSError:
            return False
    return True


class _Begin:
    """The initialisation of a worker: ignore Ctrl-C as soon as it arrives there, and end with the parent."""

    def __call__(self) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        threading.Thread(target=end_with_parent, daemon=True).start()
        if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "mallopt"):  # musl has none
            libc.mallopt(_MMAP, _IN_THE_HEAP)
            libc.mallopt(_TRIM, _KEPT)

    def __reduce__(self) -> tuple[Callable[[], _Begin], tuple[()]]:
        return _ignore_interrupts, ()


def _ignore_interrupts() -> _Begin:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return _Begin()
