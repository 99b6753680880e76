"""Work beside other work, on another of the machine's cores."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

THREADS = "JOINTID_THREADS"
"""The variable of the environment that says how many threads a computation may use."""


def threads() -> int:
    """Number of threads: one per usable core, or JOINTID_THREADS."""
    said = os.environ.get(THREADS, "")
    return max(int(said), 1) if said.isdecimal() else cores()


def cores() -> int:
    """Number of usable cores; at most 61 elsewhere than on Linux, as Windows waits for no more processes."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else min(os.cpu_count() or 1, 61)


_SHARED = threading.local()  # of each thread, whether it is one of several that share the cores


def in_threads(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Map a function over items with threads, one per core; see `threads`.

    What a thread maps in turn stays in it, so that there are never more threads than cores. The results do not depend
    on the number of threads if those of the function do not.
    """
    workers = min(threads(), max(len(items), 1))
    if workers == 1 or getattr(_SHARED, "cores", False):
        return [function(item) for item in items]
    with ThreadPoolExecutor(workers, initializer=lambda: setattr(_SHARED, "cores", True)) as pool:
        return list(pool.map(function, items))


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Limit the linear algebra of NumPy and SciPy to one thread, and restore its own number afterwards.

    Matrices here are thousands of rows by ten columns: a second thread only waits for the first.
    """
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with threadpool_limits(1, "blas"):
        yield


class Aside(Generic[Result]):
    """A call in a forked process, or on demand without one.

    Only Linux forks safely. The process ends with its parent. The result must be picklable; prints are lost.
    """

    def __init__(self, call: Callable[[], Result]) -> None:
        """Start it."""
        self._call = call
        self.is_apart = sys.platform == "linux" and cores() > 1 and not multiprocessing.current_process().daemon
        if self.is_apart:
            context = multiprocessing.get_context("fork")
            self._answer, sender = context.Pipe(duplex=False)
            self._process = context.Process(target=_send, args=(call, sender), daemon=True)
            with without_interrupts(), warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # threads that only draw a bar are no hindrance
                self._process.start()
            sender.close()

    def result(self) -> Result:
        """Wait for the result; a call that failed in its process is made again, in sight."""
        if self.is_apart:
            with contextlib.suppress(EOFError, OSError):
                found: Result = self._answer.recv()
                self._process.join()  # its processor time counts as that of a child
                return found
        return self._call()


def _send(call: Callable[[], Any], sender: Connection) -> None:
    begin_worker()
    with contextlib.suppress(Exception):
        sender.send(call())


def begin_worker() -> None:
    """Begin as a worker: ignore Ctrl-C, and end with the parent, even by a kill."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextlib.contextmanager
def without_interrupts() -> Iterator[None]:
    """Block Ctrl-C, also in processes that start meanwhile."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
