"""Work beside other work, on another of the machine's cores."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from jointid.common.errors import JointidError

Result = TypeVar("Result")

_ENDINGS = (signal.SIGINT, signal.SIGTERM)

THREADS = "JOINTID_THREADS"
"""The variable of the environment that says how many threads a computation may use."""

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""Those that say so to libraries, which read them once."""


def threads() -> int:
    """Number of threads: one per core, or JOINTID_THREADS."""
    said = os.environ.get(THREADS, "")
    return max(int(said), 1) if said.isdecimal() else os.cpu_count() or 1


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

    def is_done(self, within: float = 0.0) -> bool:
        """Test whether the result arrives within some seconds; False without a process."""
        return self._answer is not None and self._answer.poll(within)

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
