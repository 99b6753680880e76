"""Threads and worker processes."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = TypeVar("Work", bound=Callable[..., object])

THREADS = "JOINTID_THREADS"
"""Environment variable with the largest number of threads of a computation."""


def threads() -> int:
    """Number of threads or processes: JOINTID_THREADS, or one per usable core."""
    if (said := os.environ.get(THREADS, "")).isdecimal():
        return max(int(said), 1)
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else min(os.cpu_count() or 1, 61)  # Windows' limit


_SHARED = threading.local()  # in each thread: whether it shares the cores with others


def in_threads(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Map a function over items with threads, one per core; see `threads`.

    Nested calls run in the calling thread, so that there are never more threads than cores. The results do not depend
    on the number of threads if those of the function do not.
    """
    workers = min(threads(), max(len(items), 1))
    if workers == 1 or getattr(_SHARED, "cores", False):
        return [function(item) for item in items]
    with ThreadPoolExecutor(workers, initializer=lambda: setattr(_SHARED, "cores", True)) as pool:
        return list(pool.map(function, items))


def one_thread(function: Work) -> Work:
    """Limit BLAS to one thread: with thousands of rows and some ten columns, further threads only wait."""
    limited: Work = threadpool_limits.wrap(limits=1, user_api="blas")(function)
    return limited


def begin_worker() -> None:
    """Initialise a worker: ignore Ctrl-C, and exit when the parent exits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent: Any = multiprocessing.parent_process()

    def end_with_parent() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


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
