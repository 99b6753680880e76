"""Engines that execute cases, as `concurrent.futures.Executor`.

The default is local processes. Dask or SLURM schedule clusters.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Protocol

from jointid.common.errors import MethodError, RecordError, extra
from jointid.common.parallel import BLAS_THREADS, THREADS, end_with_parent

_PATIENCE = 10.0  # s that a scheduler has to answer
_TRIM, _MMAP = -1, -3  # thresholds of glibc's mallopt: free memory is given back, and a block has a mapping of its own
_KEPT, _IN_THE_HEAP = 2**28, 2**25  # bytes; the latter is the most that glibc takes


@dataclass(frozen=True, slots=True)
class Workers:
    """Available workers.

    Attributes:
        capacity: how many tasks it can work at; of a cluster that is now.
        batch: cases of a task: one, where handing out a task is cheap.
        ahead: tasks under way for each that it works at, so that no worker waits for the next.
        submitted: tasks of an earlier client, which may be under way still: by the hash of each case those of its task.
    """

    executor: Executor
    capacity: Callable[[], int]
    batch: int = 1
    ahead: int = 2
    submitted: Mapping[str, frozenset[str]] = field(default_factory=dict)


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
        if sys.platform == "linux":
            context.set_forkserver_preload(["jointid.campaigns.run_case"])
        for name in BLAS_THREADS:  # a worker's libraries read this when they are loaded, before it can say so
            os.environ.setdefault(name, "1")
        before = set(multiprocessing.active_children())
        count = workers or self.workers or cores()
        executor = ProcessPoolExecutor(count, context, _begin)
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
        try:
            client = distributed.Client(self.address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise MethodError(
                f"No Dask scheduler answers at {self.address} ({type(error).__name__}); start one, and name it as "
                "tcp://10.0.0.1:8786."
            ) from error
        with client:
            executor = client.get_executor(pure=False)  # a case that is tried again is another task
            wait = False
            try:
                yield Workers(executor, lambda: _threads(client.scheduler_info(n_workers=-1)))
                wait = True
            except OSError as error:
                raise RecordError(
                    f"The Dask scheduler at {self.address} answers no more ({error}); start it again, and give the "
                    "same command again: what is finished is kept."
                ) from error
            finally:
                executor.shutdown(wait=wait)

    def is_death(self, error: BaseException) -> bool:
        """Test whether Dask gave a case up after workers died."""
        killed: type[BaseException] = extra("distributed", "cluster", "A Dask cluster").scheduler.KilledWorker
        return isinstance(error, killed)


def _threads(about: Mapping[str, Any]) -> int:
    """Number of threads of a Dask cluster."""
    return sum(int(worker["nthreads"]) for worker in about["workers"].values())


def cores() -> int:
    """Number of usable cores, at most 61 for Windows."""
    allowed = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    return min(allowed, 61) if sys.platform == "win32" else allowed


def on_one_core(carry: Callable[[Any], Any], cases: Sequence[Any]) -> list[Any]:
    """Execute cases with one thread."""
    os.environ[THREADS] = "1"
    return [carry(case) for case in cases]


def _begin() -> None:
    """Initialise a worker: ignore Ctrl-C, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=end_with_parent, daemon=True).start()
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "mallopt"):  # musl has none
        libc.mallopt(_MMAP, _IN_THE_HEAP)
        libc.mallopt(_TRIM, _KEPT)
