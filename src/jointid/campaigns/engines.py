"""Engines that execute cases, as `concurrent.futures.Executor`: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

from jointid.common.errors import MethodError, RecordError, extra
from jointid.common.parallel import BLAS_THREADS, cores, end_with_parent

_PATIENCE = 10.0  # s that a scheduler has to answer


@dataclass(frozen=True, slots=True)
class Workers:
    """Available workers.

    Attributes:
        capacity: how many cases it can work at; of a cluster that is now.
        require_reachable: raises OSError where no result can come any more.
    """

    executor: Executor
    capacity: Callable[[], int]
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
        for name in BLAS_THREADS:  # a worker's libraries read this when they are loaded, before it can say so
            os.environ.setdefault(name, "1")
        before = set(multiprocessing.active_children())
        count = workers or self.workers or cores()
        executor = _DeafProcesses(count, multiprocessing.get_context("spawn"), _begin)
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


class _DeafProcesses(ProcessPoolExecutor):
    """Processes that Ctrl-C does not reach: they are started with it blocked, so that their start cannot print one."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **more: Any) -> Future[Any]:
        if not hasattr(signal, "pthread_sigmask"):
            return super().submit(function, *args, **more)
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            return super().submit(function, *args, **more)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _begin() -> None:
    """Begin as a worker: ignore Ctrl-C, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()


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
