"""Run of a campaign: cases go to a `concurrent.futures.Executor`, and results are kept.

The executor has processes of this machine, or the workers of a Dask cluster. A dying worker takes its executor or case
with it. The culprit is unknown, so each affected case is retried alone; one that kills two workers alone is set aside.
"""

from __future__ import annotations

import contextlib
import logging
import math
import multiprocessing
import os
import platform
import signal
import threading
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jointid import Estimate, __version__
from jointid.campaigns.campaign import Case
from jointid.campaigns.store import Found, Outcome, Row, Store
from jointid.common.errors import JointidError, MethodError, RecordError, extra
from jointid.common.files import digest
from jointid.common.messages import Progress, Work, ignore_progress
from jointid.common.parallel import BLAS_THREADS, THREADS, cores, end_with_parent
from jointid.common.text import pluralise
from jointid.config import File, loads
from jointid.estimation.result.answer import Trust
from jointid.uncertainty.identifiability import Kind, Known
from jointid.uncertainty.verdict import POOR_FIT

_PATIENCE = 10.0  # s that a scheduler has to answer
_LOOK = 5.0  # s without a result, after which it is seen whether any can come
_DEATHS = 2  # of workers, after which a case is set aside
_AHEAD = 2  # cases under way for each worker, so that none waits for the next

Carry = Callable[[Case], Row]
Keep = Callable[[Row], None]


def run_case(case: Case) -> Row:
    """Identify a case and return its row; failures become sentences.

    Example:
        >>> from jointid.campaigns.campaign import Case
        >>> from jointid.campaigns.run import run_case
        >>> row = run_case(Case("axis 1", "[joint]", "axis-1.csv", ""))
        >>> print(row.outcome, row.sentence)
        refused axis-1.csv cannot be opened (no such file or directory); check the path.
    """
    about: dict[str, Any] = {"versions": versions()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if case.program != __version__:
                raise RecordError(
                    f"The case was described by jointid {case.program}, and the worker has {__version__}; install the "
                    "same on both."
                )
            about["record_sha256"] = digest(path := Path(case.record))
            return Row.of(case, **_identify(case, path), **about)
        except JointidError as error:
            return Row.of(case, Outcome.REFUSED, str(error), **about)
        except Exception as error:
            sentence = f"jointid failed, which is a fault of ours ({type(error).__name__}: {error})."
            return Row.of(case, Outcome.FAILED, sentence, **about)


@cache
def versions() -> dict[str, str]:
    """Versions of jointid, Python and numerical libraries."""
    return {
        "jointid": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "numba")},
    }


def _finite(value: float | None) -> float | None:
    """Return a finite number, else None, for JSON."""
    return None if value is None or not math.isfinite(value) else float(value)


@lru_cache(maxsize=64)
def _file(text: str, changes: tuple[str, ...]) -> File:
    return loads(text, changes=changes)


def _identify(case: Case, path: Path) -> dict[str, Any]:
    """Entries of a row from an estimate."""
    file = _file(case.joint_file, (*case.settings, *case.changes))
    if file.runs:
        raise MethodError(
            f"The joint file of {case.joint} lists several [[records]], and a campaign identifies from one at a time; "
            "leave them out."
        )
    estimate = file.identify(file.record(path))
    of_robot = estimate.robot is not None  # of which every number counts, those of its logs, too
    found = {
        p.name: Found(_finite(p.value), _finite(p.stderr) if p.free else None, p.unit)
        for p in estimate.params.rows
        if p.of_joint or of_robot
    }
    found |= {
        name: Found(_finite(one.value), _finite(one.std), one.combination.unit) for name, one in _totals(estimate)
    }
    # That the law as declared does not fit is no reason here: where it never fits, changes are still to be seen.
    fits = estimate.fit.filtered_error <= POOR_FIT  # not so where it is NaN
    usable = estimate.fit.converged and fits and estimate.answer.trust.code is not Trust.REFUSED
    return {
        "outcome": Outcome.IDENTIFIED if usable else Outcome.DOUBTFUL,
        "sentence": estimate.sentence,
        "found": found,
        "trust": str(estimate.answer.trust.code),
        "converged": bool(estimate.fit.converged),
        "error_percent": _finite(100 * estimate.fit.filtered_error),
        "simulations": int(estimate.fit.simulations),
    }


def _totals(estimate: Estimate) -> Iterator[tuple[str, Known]]:
    """Yield the sums of both sides, identifiable where their parts are not."""
    known = estimate.checks.known
    for one in () if known is None else known.physical:
        if one.combination.kind is Kind.SUM:
            yield f"total_{one.combination.quantity}", one


@dataclass(frozen=True, slots=True)
class Workers:
    """An executor of cases.

    Attributes:
        capacity: returns how many cases it can work at; of a cluster that is now.
        require_reachable: raises OSError where no result can come any more.
    """

    executor: Executor
    capacity: Callable[[], int]
    require_reachable: Callable[[], None] = lambda: None


Engine = Callable[[bool], AbstractContextManager[Workers]]
"""Opens workers: all of them, or one alone. An exception abandons the cases that are under way."""


@contextlib.contextmanager
def local_processes(alone: bool = False, count: int = 0) -> Iterator[Workers]:
    """Yield single-threaded processes that end with their parent.

    Args:
        alone: whether one is enough.
        count: how many; one for each core when 0.
    """
    for name in BLAS_THREADS:  # a worker's libraries read this when they are loaded, before it can say so
        os.environ.setdefault(name, "1")
    before, count = set(multiprocessing.active_children()), 1 if alone else count or cores()
    executor = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin_worker)
    try:
        yield Workers(executor, lambda: count)
    except BaseException:
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _begin_worker() -> None:
    """Begin as a worker: ignore Ctrl-C, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=end_with_parent, daemon=True).start()


@contextlib.contextmanager
def dask_cluster(_: bool = False, *, address: str) -> Iterator[Workers]:
    """Yield the changing workers of an existing Dask cluster.

    Dask gives a case of a worker that died to another one, and gives it up after some deaths (its setting
    ``distributed.scheduler.allowed-failures``). It counts the deaths of workers at which a case was only waiting, too.

    Args:
        address: of its scheduler, as tcp://10.0.0.1:8786.
    """
    distributed = extra("distributed", "cluster", "A Dask cluster")
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # of a scheduler that is gone they print tracebacks
    try:
        client = distributed.Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise MethodError(
            f"No Dask scheduler answers at {address} ({type(error).__name__}); start one, and name it as "
            "tcp://10.0.0.1:8786."
        ) from error
    with client:
        executor = client.get_executor(pure=False)  # a case that is tried again is another task
        wait_for_all, first = False, client.scheduler_info()["id"]

        def require_reachable() -> None:
            if client.status != "running" or client.scheduler_info()["id"] != first:
                raise OSError  # another scheduler knows none of these tasks, and Dask does not always say so

        def capacity() -> int:
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
            return sum(int(one["nthreads"]) for one in workers)

        try:
            yield Workers(executor, capacity, require_reachable)
            wait_for_all = True
        except (OSError, RecordError) as error:  # this of cases that are cancelled when the connection is lost
            if isinstance(error, RecordError) and client.status == "running":
                raise
            raise RecordError(
                f"The Dask scheduler at {address} answers no more; start it again, and give the same command again: "
                "what is finished is kept."
            ) from error
        finally:
            executor.shutdown(wait=wait_for_all)


@dataclass(frozen=True, slots=True)
class Ran:
    """Summary of a run.

    Attributes:
        made: results that this run made, by how they ended.
    """

    cases: int
    found: int
    made: dict[Outcome, int]

    def __str__(self) -> str:
        """Return it in a sentence."""
        ends = ", ".join(f"{count} {outcome}" for outcome, count in self.made.items() if count)
        before = f", {self.found} of them before" if self.found else ""
        return f"{pluralise(self.cases, 'case')} done{before}{f': {ends}' if ends else ''}."


def run_cases(
    cases: Callable[[], Iterable[Case]],
    engine: Engine,
    store: Store,
    *,
    carry: Carry = run_case,
    progress: Progress = ignore_progress,
) -> Ran:
    """Execute the cases of a campaign without a result.

    Args:
        cases: returns a new iterator each time; cases need not fit into memory.
        engine: opens the workers that execute them, as `local_processes`.
        store: keeps the results.
        carry: the function of a case.
        progress: receives number done, rate and time left.
    """
    finished = Counter(map(store.has_result, dict.fromkeys(case.content_hash for case in cases())))
    made = dict.fromkeys(Outcome, 0)
    if finished[False]:
        work = Work(progress, "cases", finished[False], "cases")

        def keep(row: Row) -> None:
            if not store.has_result(row.content_hash):
                store.add(row)
                made[row.outcome] += 1
                work.add()

        waiting = (case for case in cases() if not store.has_result(case.content_hash))
        try:
            while affected := _run_together(waiting, engine, carry, keep):
                progress(
                    f"a worker died; {pluralise(len(affected), 'case')} that it may have died of "
                    f"{'is' if len(affected) == 1 else 'are'} tried again, one at a time"
                )
                for case in affected:
                    keep(_run_single(case, engine, store, carry))
        finally:
            work.reach(finished[False])
    return Ran(finished.total(), finished[True], made)


def _run_together(waiting: Iterator[Case], engine: Engine, carry: Carry, keep: Keep) -> list[Case]:
    """Execute cases until all are done or a worker dies; return the unfinished ones that were under way."""
    affected, under_way = list[Case](), dict[Future[Row], Case]()
    with engine(False) as workers:
        while True:
            most = _AHEAD * max(workers.capacity(), 1)
            while not affected and len(under_way) < most and (case := next(waiting, None)) is not None:
                try:
                    under_way[_submit(workers, carry, case)] = case
                except BrokenExecutor:
                    affected.append(case)
            if not under_way:
                return affected
            done, _ = wait(under_way, timeout=_LOOK, return_when=FIRST_COMPLETED)
            if not done:
                workers.require_reachable()
            for future in done:
                case, row = under_way.pop(future), _result(future)
                if row is None:
                    affected.append(case)
                else:
                    keep(row)


def _run_single(case: Case, engine: Engine, store: Store, carry: Carry) -> Row:
    """Execute a case without others, and set it aside after two deaths."""
    while True:
        with engine(True) as workers:
            row = _result(_submit(workers, carry, case))
        if row is not None:
            return row
        if store.count_death(case.content_hash) >= _DEATHS:
            sentence = (
                f"{_DEATHS} workers died of {case.record} with nothing else to do, so it was set aside; look into the "
                "record, and into the worker's memory."
            )
            return Row.of(case, Outcome.SET_ASIDE, sentence)


def _submit(workers: Workers, carry: Carry, case: Case) -> Future[Row]:
    """Submit a case; a process that starts for it has Ctrl-C blocked, so that its start cannot print one."""
    if not hasattr(signal, "pthread_sigmask"):
        return workers.executor.submit(_carry_on_one_core, carry, case)
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        return workers.executor.submit(_carry_on_one_core, carry, case)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _carry_on_one_core(carry: Carry, case: Case) -> Row:
    os.environ[THREADS] = "1"
    return carry(case)


def _result(future: Future[Row]) -> Row | None:
    """Return the row of a case; None if its worker died."""
    try:
        return future.result()
    except JointidError:
        raise
    except Exception as error:
        if (
            isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"
        ):  # Dask's, which may not be there
            return None
        raise RecordError(
            f"The workers gave a case up ({type(error).__name__}: {error}); see that they can be reached, and that "
            "each has this jointid and its extras, and give the same command again: what is finished is kept."
        ) from error
