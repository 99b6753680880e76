"""Engines: who carries out the cases, behind the one seam of `concurrent.futures.Executor`.

Processes of this machine by default. What schedules a cluster is Dask's or SLURM's own, not ours.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from dataclasses import dataclass
from typing import Protocol

from jointid.common.parallel import ONE_THREAD, end_with_parent


class Engine(Protocol):
    """Something that opens an executor; a worker that dies shows as an exception of its own."""

    def open(self, workers: int | None = None) -> contextlib.AbstractContextManager[Executor]:
        """Return an executor of all its workers, or of so many; left by an exception it abandons what is running."""

    def capacity(self) -> int:
        """Return how many cases it can work at now."""

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
    def open(self, workers: int | None = None) -> Iterator[Executor]:
        """Yield an executor; see `Engine`."""
        # A fork of this process would copy its threads' locks; on Linux a server without threads is forked instead.
        context = multiprocessing.get_context("forkserver" if sys.platform == "linux" else "spawn")
        if sys.platform == "linux":
            context.set_forkserver_preload(["jointid.campaigns.run_case"])
        for name, one in ONE_THREAD.items():  # the libraries of a worker read this when they are loaded
            os.environ.setdefault(name, one)
        before = set(multiprocessing.active_children())
        executor = ProcessPoolExecutor(workers or self.capacity(), context, _begin)
        try:
            yield executor
        except BaseException:
            for process in set(multiprocessing.active_children()) - before:
                process.terminate()
            raise
        finally:
            executor.shutdown(wait=True, cancel_futures=True)

    def capacity(self) -> int:
        """Return how many processes there are."""
        return self.workers or os.cpu_count() or 1

    def is_death(self, error: BaseException) -> bool:
        """Return whether a process died; those that were beside it are ended, too."""
        return isinstance(error, BrokenExecutor)


def _begin() -> None:
    """Prepare a worker: Ctrl-C is the client's to answer, and whoever is killed leaves no worker behind."""
    os.environ |= ONE_THREAD
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=end_with_parent, daemon=True).start()
