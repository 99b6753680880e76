"""Run of a campaign: cases, their executor, and a results file.

The `concurrent.futures.Executor` has local processes or the workers of a Dask cluster. A dying worker takes its
executor or case with it. Each affected case is retried alone; a case that kills two workers alone is set aside.

Each line of the file is the result of a case; the last one of a case counts. A case is finished once its line is on
the disk. A kill or a full disk may truncate the last line; its case is then run again.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import multiprocessing
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

from jointid import __version__
from jointid.campaigns.campaign import Case, canonical
from jointid.common.errors import JointidError, MethodError, RecordError, extra
from jointid.common.files import digest, explain, lock, open_file
from jointid.common.messages import Progress, ignore_progress, pace
from jointid.common.parallel import THREADS, begin_worker, threads, without_interrupts
from jointid.common.text import pluralise
from jointid.config import loads
from jointid.estimation.result.fields import read
from jointid.estimation.result.verdict import POOR_FIT, Trust

_PATIENCE = 10.0  # s, timeout of the scheduler
_LOOK = 5.0  # s without a result before the workers are checked
_DEATHS = 2  # worker deaths after which a case is set aside
_AHEAD = 2  # cases submitted per worker, so that none is idle


_BEGIN = b'{"changes":'  # the start of each line, whose keys are sorted


class Outcome(StrEnum):
    """How a case ended."""

    IDENTIFIED = "identified"
    DOUBTFUL = "not reliable"
    REFUSED = "refused"
    FAILED = "failed"
    SET_ASIDE = "set aside"


RETRIED = (Outcome.REFUSED, Outcome.FAILED, Outcome.SET_ASIDE)
"""Outcomes to retry on request; an unreliable answer is kept."""


@dataclass(frozen=True, slots=True)
class Found:
    """An identified parameter or combination.

    Attributes:
        value: in SI units; None if refused.
        std: its standard deviation; None if it was fixed.
    """

    value: float | None
    std: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class Row:
    """The result of a case.

    Attributes:
        outcome: a refusal is a fault of the record or joint file, a failure one of jointid. A search that does not
            converge or fit is not reliable.
        sentence: the answer in a line, or why there is none.
        found: parameters, and sums that are identifiable where their parts are not, by name.
        trust: code of the answer's reliability.
        error_percent: norm of the filtered torque error over that of the torque.
        record_sha256: digest of the record; empty if unreadable.
        program: the version of jointid that identified it.
    """

    content_hash: str
    joint: str
    record: str
    day: str
    changes: tuple[str, ...]
    outcome: Outcome
    sentence: str
    found: Mapping[str, Found] = field(default_factory=dict)
    trust: str = ""
    error_percent: float | None = None
    record_sha256: str = ""
    settings: tuple[str, ...] = ()
    program: str = __version__

    @classmethod
    def of(cls, case: Case, outcome: Outcome, sentence: str, **more: Any) -> Self:
        """Return the row of a case."""
        about = (case.content_hash, case.joint, case.record, case.day, case.changes)
        return cls(*about, outcome, sentence, settings=case.settings, **more)

    @property
    def place(self) -> tuple[str, str, str, tuple[str, ...], str]:
        """Sort key, independent of engine and order."""
        return (self.joint, self.day, self.record, self.changes, self.content_hash)


class Store:
    """The results of a campaign; see `open_store`."""

    def __init__(self, path: Path, descriptor: int, *, again: bool = False) -> None:
        self._path, self._descriptor = path, descriptor
        self._rows = dict[str, Row]()
        whole = self._read()
        self._retried = {row.content_hash for row in self._rows.values() if again and row.outcome in RETRIED}
        with explain(path):
            os.ftruncate(descriptor, whole)  # drop a line that a kill truncated

    def has_result(self, content_hash: str) -> bool:
        """Test whether a case has a result to keep."""
        return content_hash in self._rows and content_hash not in self._retried

    def add(self, row: Row) -> None:
        """Store a result; it is on the disk on return."""
        content = (canonical(asdict(row)) + "\n").encode("utf-8", "surrogatepass")
        with explain(self._path):
            while content:  # after a partial write, the next attempt raises the reason
                content = content[os.write(self._descriptor, content) :]
            os.fsync(self._descriptor)
        self._rows[row.content_hash] = row
        self._retried.discard(row.content_hash)

    def rows_of(self, hashes: Iterable[str]) -> tuple[Row, ...]:
        """Return the results of cases, in an order independent of the engine."""
        found = [self._rows[one] for one in dict.fromkeys(hashes) if one in self._rows]
        return tuple(sorted(found, key=lambda row: row.place))

    def _read(self) -> int:
        """Read the stored results; return the byte size of complete lines."""
        whole = 0
        with explain(self._path), open_file(self._path) as file:
            for number, line in enumerate(file, 1):
                if not line.endswith(b"\n") and (line.startswith(_BEGIN) or _BEGIN.startswith(line)):
                    break  # truncated by a kill
                try:
                    row = read(Row, json.loads(line))
                except (ValueError, TypeError, OverflowError, RecursionError) as error:
                    raise RecordError(
                        f"{self._path}, line {number} is no result of a campaign ({error}); name another file by --out."
                    ) from error
                self._rows[row.content_hash] = row
                whole += len(line)
        return whole


@contextlib.contextmanager
def open_store(path: Path, *, again: bool = False) -> Iterator[Store]:
    """Yield the results in a file, for one process at a time.

    Args:
        path: of the file, which is created if missing.
        again: whether to retry cases that were refused, failed or set aside.
    """
    with explain(path):
        if path.exists():
            open_file(path).close()  # refuses a pipe or a device
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
        descriptor = os.open(path, flags, 0o666)
    try:
        if not lock(descriptor):
            raise RecordError(
                f"Another campaign is at work on {path}; wait for its end, or name another file by --out."
            )
        yield Store(path, descriptor, again=again)
    finally:
        os.close(descriptor)


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
    of_robot = estimate.robot is not None  # every number of a robot counts, also those of its logs
    known = estimate.known
    sums = [] if known is None else known.physical
    numbers = [
        *((p.name, p.value, p.stderr if p.free else None, p.unit) for p in estimate.rows if p.of_joint or of_robot),
        # The sums of both sides are identifiable where their parts are not.
        *((f"total_{one.combination.quantity}", one.value, one.std, one.combination.unit) for one in sums),
    ]
    # A controller that does not fit as declared is accepted: changes show even where it never fits.
    fits = estimate.fit.filtered_error <= POOR_FIT  # False for NaN
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
"""An executor of cases, and a function that returns its present number of workers.

The function raises OSError if no further result can come.
"""

Engine = Callable[[], AbstractContextManager[Workers]]
"""Context manager of workers; an exception abandons the cases under way."""


@contextlib.contextmanager
def local_processes(count: int = 0) -> Iterator[Workers]:
    """Yield single-threaded worker processes that end with their parent.

    Args:
        count: largest number; 0 for one per core.
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

    Dask moves the case of a dead worker to another one, and gives up after some deaths (its setting
    ``distributed.scheduler.allowed-failures``). It also counts deaths of workers at which a case only waited.

    Args:
        address: of its scheduler, such as tcp://10.0.0.1:8786.
    """
    distributed = extra("distributed", "cluster", "A Dask cluster")
    for name in ("distributed", "distributed.client", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # they print tracebacks when the scheduler is gone
    try:
        with distributed.Client(address, timeout=_PATIENCE, set_as_default=False) as client:
            first = client.scheduler_info()["id"]

            def capacity() -> int:
                about = client.scheduler_info(n_workers=-1)
                if client.status != "running" or about["id"] != first:
                    raise OSError  # another scheduler has none of these tasks, and Dask does not always report that
                return sum(int(one["nthreads"]) for one in about["workers"].values())

            yield client.get_executor(pure=False), capacity  # a retried case is a new task
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
    """Execute unfinished cases of a campaign; return counts by outcome.

    Args:
        cases: of the campaign.
        engine: opens the workers, such as `local_processes`.
        store: keeps the results.
        carry: function that executes a case.
        progress: receives the number of finished cases.
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
        progress(f"a worker died; what may have ended it is tried again: {pluralise(len(affected), 'case')}")
        for case in affected:
            if all(_run_together(iter([case]), engine, carry, keep) for _ in range(_DEATHS)):
                sentence = (
                    f"{_DEATHS} workers died of {case.record} with nothing else to do, so it was set aside; look "
                    "into the record, and into the worker's memory."
                )
                keep(Row.of(case, Outcome.SET_ASIDE, sentence))
    return made


def _run_together(waiting: Iterator[Case], engine: Engine, carry: Carry, keep: Keep) -> list[Case]:
    """Execute cases until done or a worker dies; return unfinished ones."""
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
