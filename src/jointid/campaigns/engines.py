"""Engines: who carries out the cases, behind the one seam of `concurrent.futures.Executor`.

Processes of this machine by default. What schedules a cluster is Dask's or SLURM's own, not ours.
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
    """Workers that are ready.

    Attributes:
        executor: takes the cases.
        capacity: how many tasks it can work at; of a cluster that is now.
        batch: cases of a task: one, where handing out a task is cheap.
        ahead: tasks under way for each that it works at, so that no worker waits for the next.
        begun: tasks of an earlier client, which may be under way still: by the hash of each case those of its task.
    """

    executor: Executor
    capacity: Callable[[], int]
    batch: int = 1
    ahead: int = 2
    begun: Mapping[str, frozenset[str]] = field(default_factory=dict)


class Engine(Protocol):
    """Something that has workers; one that dies shows as an exception of its own."""

    def open(self, workers: int | None = None) -> contextlib.AbstractContextManager[Workers]:
        """Return all its workers, or so many; left by an exception it abandons what is running."""

    def is_death(self, error: BaseException) -> bool:
        """Return whether an exception of a future is the death of the worker that had its case."""


@dataclass(frozen=True, slots=True)
class LocalProcesses:
    """Processes of this machine, each of one thread, which end with the one that started them.

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
        """Return whether a process died; those that were beside it are ended, too."""
        return isinstance(error, BrokenExecutor)


@dataclass(frozen=True, slots=True)
class DaskCluster:
    """The workers of a Dask cluster that is there; some may come and go while a campaign runs.

    Dask gives a case of a worker that died to another one, and gives it up after some deaths (its setting
    ``distributed.scheduler.allowed-failures``). It counts the deaths of workers at which a case was only waiting, too:
    who is to blame is found out as for any engine.

    Attributes:
        address: of its scheduler, as tcp://10.0.0.1:8786.
    """

    address: str

    @contextlib.contextmanager
    def open(self, workers: int | None = None) -> Iterator[Workers]:
        """Yield the workers; see `Engine`. How many workers there are is the cluster's."""
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
        """Return whether Dask gave a case up because of the workers that died with it."""
        killed: type[BaseException] = extra("distributed", "cluster", "A Dask cluster").scheduler.KilledWorker
        return isinstance(error, killed)


def _threads(about: Mapping[str, Any]) -> int:
    """Return how many threads the workers of a Dask cluster have."""
    return sum(int(worker["nthreads"]) for worker in about["workers"].values())


def cores() -> int:
    """Return how many cores this process may use; Windows waits for no more than 61 workers."""
    allowed = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    return min(allowed, 61) if sys.platform == "win32" else allowed


def on_one_core(carry: Callable[[Any], Any], cases: Sequence[Any]) -> list[Any]:
    """Carry out cases with one thread: the other cores are for those beside it."""
    os.environ[THREADS] = "1"
    return [carry(case) for case in cases]


def _begin() -> None:
    """Prepare a worker: Ctrl-C is the client's to answer, and whoever is killed leaves no worker behind."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=end_with_parent, daemon=True).start()
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "mallopt"):  # musl has none
        libc.mallopt(_MMAP, _IN_THE_HEAP)
        libc.mallopt(_TRIM, _KEPT)
