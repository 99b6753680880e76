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
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager
from functools import lru_cache
from pathlib import Path
from typing import Any

from jointid import __version__
from jointid.campaigns.campaign import Case
from jointid.campaigns.store import Found, Outcome, Row, Store
from jointid.common.errors import JointidError, MethodError, RecordError, extra
from jointid.common.files import digest
from jointid.common.messages import Progress, ignore_progress, pace
from jointid.common.parallel import THREADS, begin_worker, threads, without_interrupts
from jointid.common.text import pluralise
from jointid.config import loads
from jointid.estimation.result.answer import Trust
from jointid.estimation.result.verdict import POOR_FIT

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
    sha256 = ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if case.program != __version__:
                raise RecordError(
                    f"The case was described by jointid {case.program}, and the worker has {__version__}; install the "
                    "same on both."
                )
            sha256 = digest(Path(case.record))
            return Row.of(case, **_identify(case), record_sha256=sha256)
        except JointidError as error:
            return Row.of(case, Outcome.REFUSED, str(error), record_sha256=sha256)
        except Exception as error:
            sentence = f"jointid failed, which is a fault of ours ({type(error).__name__}: {error})."
            return Row.of(case, Outcome.FAILED, sentence, record_sha256=sha256)


_load = lru_cache(maxsize=64)(loads)


def _identify(case: Case) -> dict[str, Any]:
    """Entries of a row from an estimate."""
    file = _load(case.joint_file, changes=(*case.settings, *case.changes))
    if file.runs:
        raise MethodError(
            f"The joint file of {case.joint} lists several [[records]], and a campaign identifies from one at a time; "
            "leave them out."
        )
    estimate = file.identify(file.record(case.record))
    of_robot = estimate.robot is not None  # of which every number counts, those of its logs, too
    known = estimate.known
    sums = [] if known is None else known.physical
    numbers = [
        *((p.name, p.value, p.stderr if p.free else None, p.unit) for p in estimate.rows if p.of_joint or of_robot),
        # The sums of both sides are identifiable where their parts are not.
        *((f"total_{one.combination.quantity}", one.value, one.std, one.combination.unit) for one in sums),
    ]
    # That the law as declared does not fit is no reason here: where it never fits, changes are still to be seen.
    fits = estimate.fit.filtered_error <= POOR_FIT  # not so where it is NaN
    usable = estimate.fit.converged and fits and estimate.answer.trust.code is not Trust.REFUSED
    return {
        "outcome": Outcome.IDENTIFIED if usable else Outcome.DOUBTFUL,
        "sentence": estimate.sentence,
        "found": {name: Found(_finite(value), _finite(std), unit) for name, value, std, unit in numbers},
        "trust": str(estimate.answer.trust.code),
        "error_percent": _finite(100 * estimate.fit.filtered_error),
    }


def _finite(value: float | None) -> float | None:
    """Return a finite number, else None, for JSON."""
    return None if value is None or not math.isfinite(value) else float(value)


Workers = tuple[Executor, Callable[[], int]]
"""An executor of cases, and a function that returns how many it can work at now.

The function raises OSError where no result can come any more.
"""

Engine = Callable[[], AbstractContextManager[Workers]]
"""Opens workers. An exception abandons the cases that are under way."""


@contextlib.contextmanager
def local_processes(count: int = 0) -> Iterator[Workers]:
    """Yield single-threaded processes that end with their parent.

    Args:
        count: how many at most; one for each core when 0.
    """
    before, count = set(multiprocessing.active_children()), count or threads()
    executor = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), begin_worker)
    try:
        yield executor, lambda: count
    except BaseException:
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def dask_cluster(address: str) -> Iterator[Workers]:
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
        with distributed.Client(address, timeout=_PATIENCE, set_as_default=False) as client:
            first = client.scheduler_info()["id"]

            def capacity() -> int:
                about = client.scheduler_info(n_workers=-1)
                if client.status != "running" or about["id"] != first:
                    raise OSError  # another scheduler knows none of these tasks, and Dask does not always say so
                return sum(int(one["nthreads"]) for one in about["workers"].values())

            yield client.get_executor(pure=False), capacity  # a case that is tried again is another task
    except (OSError, ValueError) as error:
        raise MethodError(
            f"No Dask scheduler answers at {address}, as tcp://10.0.0.1:8786, or not any more; start one, and give the "
            "same command again: what is finished is kept."
        ) from error


def run_cases(
    cases: Iterable[Case],
    engine: Engine,
    store: Store,
    *,
    carry: Carry = run_case,
    progress: Progress = ignore_progress,
) -> dict[Outcome, int]:
    """Execute the cases of a campaign without a result, and return how many ended how.

    Args:
        cases: of the campaign.
        engine: opens the workers that execute them, as `local_processes`.
        store: keeps the results.
        carry: the function of a case.
        progress: receives number done and time left.
    """
    waiting = [case for case in dict.fromkeys(cases) if not store.has_result(case.content_hash)]
    made = dict.fromkeys(Outcome, 0)
    if not waiting:
        return made
    reach, rest = pace(progress, "cases", len(waiting), "cases"), iter(waiting)

    def keep(row: Row) -> None:
        store.add(row)
        made[row.outcome] += 1
        reach(sum(made.values()))

    while affected := _run_together(rest, engine, carry, keep):
        progress(f"a worker died; what it may have died of is tried again: {pluralise(len(affected), 'case')}")
        for case in affected:
            if all(_run_together(iter([case]), engine, carry, keep) for _ in range(_DEATHS)):
                sentence = (
                    f"{_DEATHS} workers died of {case.record} with nothing else to do, so it was set aside; look "
                    "into the record, and into the worker's memory."
                )
                keep(Row.of(case, Outcome.SET_ASIDE, sentence))
    return made


def _run_together(waiting: Iterator[Case], engine: Engine, carry: Carry, keep: Keep) -> list[Case]:
    """Execute cases until all are done or a worker dies; return the unfinished ones that were under way."""
    affected, under_way = list[Case](), dict[Future[Row], Case]()
    with engine() as (executor, capacity):
        while True:
            most = _AHEAD * max(capacity(), 1)
            while not affected and len(under_way) < most and (case := next(waiting, None)) is not None:
                try:
                    with without_interrupts():
                        under_way[executor.submit(_carry_on_one_core, carry, case)] = case
                except BrokenExecutor:
                    affected.append(case)
            if not under_way:
                return affected
            for future in wait(under_way, timeout=_LOOK, return_when=FIRST_COMPLETED).done:
                case, row = under_way.pop(future), _result(future)
                if row is None:
                    affected.append(case)
                else:
                    keep(row)


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
        if isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":  # of Dask, if it is there
            return None
        raise RecordError(
            f"The workers gave a case up ({type(error).__name__}: {error}); see that they can be reached, and that "
            "each has this jointid and its extras, and give the same command again: what is finished is kept."
        ) from error
