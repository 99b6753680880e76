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

from jointid.common.errors import JointidError

Item = TypeVar("Item")
Result = TypeVar("Result")

_ENDINGS = (signal.SIGINT, signal.SIGTERM)

THREADS = "JOINTID_THREADS"
"""The variable of the environment that says how many threads a computation may use."""

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""Those that say so to libraries, which read them once."""


def threads() -> int:
    """Number of threads: one per usable core, or JOINTID_THREADS."""
    said = os.environ.get(THREADS, "")
    return max(int(said), 1) if said.isdecimal() else cores()


def cores() -> int:
    """Number of usable cores, at most 61 for Windows."""
    allowed = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    return min(allowed, 61) if sys.platform == "win32" else allowed


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


_limits, _guard = list[Any](), threading.Lock()  # of each call that goes on


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Limit the linear algebra of NumPy and SciPy to one thread, and restore its own number afterwards.

    Matrices here are thousands of rows by ten columns: a second thread only waits for the first. The limit holds for
    the process; the last of several calls at once takes it away.
    """
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with _guard:
        _limits.append(threadpool_limits(1, "blas"))
    try:
        yield
    finally:
        with _guard:
            _limits.pop().restore_original_limits()


class Aside(Generic[Result]):
    """A call in a forked process, or on demand without one.

    Only Linux forks safely. The process ends with its parent. The result must be picklable; prints are lost.
    """

    def __init__(self, call: Callable[[], Result]) -> None:
        """Start it."""
        self._call, self._answer, self._process = call, None, None
        alone = (os.cpu_count() or 1) < 2 or multiprocessing.current_process().daemon
        if sys.platform != "linux" or alone:
            return
        context = multiprocessing.get_context("fork")
        self._answer, sender = context.Pipe(duplex=False)
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)  # until it knows how to end without a word
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # threads that only draw a bar are no hindrance
                self._process = context.Process(target=_send, args=(call, sender), daemon=True)
                self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        sender.close()

    @property
    def is_apart(self) -> bool:
        """Whether it runs in a separate process."""
        return self._process is not None

    def result(self) -> Result:
        """Wait for the result."""
        if self._answer is not None and self._process is not None:
            try:
                good, found = self._answer.recv()
            except EOFError:  # it was killed, or had a fault of ours, which shows here
                return self._call()
            self._process.join()  # its processor time counts as that of a child
            if not good:
                raise found
            result: Result = found
            return result
        return self._call()


def end_with_parent() -> None:
    """End this process when its parent ends, even by a kill."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _send(call: Callable[[], Any], sender: Connection) -> None:
    threading.Thread(target=end_with_parent, daemon=True).start()
    for ending in _ENDINGS:
        signal.signal(ending, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDINGS)
    try:
        try:
            sender.send((True, call()))
        except JointidError as error:
            sender.send((False, error))
    except Exception:  # without an answer the call is made again, in sight
        sender.close()
