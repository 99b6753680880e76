"""Engines that execute cases, as `concurrent.futures.Executor`.

The default is local processes; Dask has the workers of a cluster.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import multiprocessing
import os
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, Protocol

from jointid.common.errors import MethodError, RecordError, extra
from jointid.common.parallel import BLAS_THREADS, cores, end_with_parent

_PATIENCE = 10.0  # s that a scheduler has to answer
_TRIM, _MMAP = -1, -3  # thresholds of glibc's mallopt: free memory is given back, and a block has a mapping of its own
_KEPT, _IN_THE_HEAP = 2**28, 2**25  # bytes; the latter is the most that glibc takes
_PRELOADED = ("jointid.campaigns.fork_server", "jointid.campaigns.run")


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
