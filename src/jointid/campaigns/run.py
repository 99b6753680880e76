"""Run of a campaign: submit cases to the engine and keep results.

A dying worker takes its executor or case with it. The culprit is unknown, so each affected case is retried alone; one
that kills two workers alone is set aside.
"""

from __future__ import annotations

import os
import platform
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jointid import Estimate, __version__
from jointid.campaigns.cases import Case, Found, Outcome, Row, finite
from jointid.campaigns.engines import Engine
from jointid.campaigns.paths import digest
from jointid.campaigns.store import Store
from jointid.common.errors import JointidError, MethodError, RecordError
from jointid.common.messages import Progress, Work, ignore_progress
from jointid.common.parallel import THREADS
from jointid.common.text import pluralise
from jointid.config import JointFile, loads
from jointid.config.contents import File
from jointid.config.robot_file import RobotFile
from jointid.estimation.result.answer import Trust
from jointid.uncertainty.identifiability import Kind, Known
from jointid.uncertainty.verdict import POOR_FIT


def run_case(case: Case) -> Row:
    """Identify a case and return its row; failures become sentences.

    Example:
        >>> from jointid.campaigns.cases import Case
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


@lru_cache(maxsize=64)
def _file(text: str, changes: tuple[str, ...]) -> JointFile | RobotFile:
    return loads(text, changes=changes)


def _identify(case: Case, path: Path) -> dict[str, Any]:
    """Entries of a row from an estimate."""
    file: File[Any] = _file(case.joint_file, (*case.settings, *case.changes))
    if file.runs:
        raise MethodError(
            f"The joint file of {case.joint} lists several [[records]], and a campaign identifies from one at a time; "
            "leave them out."
        )
    estimate = file.identify(file.record(path))
    of_robot = estimate.robot is not None  # of which every number counts, those of its logs, too
    found = {
        p.name: Found(finite(p.value), finite(p.stderr) if p.free else None, p.unit)
        for p in estimate.params.rows
        if p.of_joint or of_robot
    }
    found |= {name: Found(finite(one.value), finite(one.std), one.combination.unit) for name, one in _totals(estimate)}
    # That the law as declared does not fit is no reason here: where it never fits, changes are still to be seen.
    fits = estimate.fit.filtered_error <= POOR_FIT  # not so where it is NaN
    usable = estimate.fit.converged and fits and estimate.answer.trust.code is not Trust.REFUSED
    return {
        "outcome": Outcome.IDENTIFIED if usable else Outcome.DOUBTFUL,
        "sentence": estimate.sentence,
        "found": found,
        "trust": str(estimate.answer.trust.code),
        "converged": bool(estimate.fit.converged),
        "error_percent": finite(100 * estimate.fit.filtered_error),
        "simulations": int(estimate.fit.simulations),
    }


def _totals(estimate: Estimate) -> Iterator[tuple[str, Known]]:
    """Yield the sums of both sides, identifiable where their parts are not."""
    known = estimate.checks.known
    for one in () if known is None else known.physical:
        if one.combination.kind is Kind.SUM:
            yield f"total_{one.combination.quantity}", one


_LOOK = 5.0  # s without a result, after which it is seen whether any can come
_DEATHS = 2  # of workers, after which a case is set aside
_AHEAD = 2  # cases under way for each worker, so that none waits for the next

Carry = Callable[[Case], Row]
Keep = Callable[[Row], None]


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
        engine: executes them.
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
                    _run_single(case, engine, store, carry, keep)
        finally:
            work.reach(finished[False])
    return Ran(finished.total(), finished[True], made)


def _run_together(waiting: Iterator[Case], engine: Engine, carry: Carry, keep: Keep) -> list[Case]:
    """Execute cases until all are done or a worker dies; return the unfinished ones that were under way."""
    affected: list[Case] = []
    under_way: dict[Future[Row], Case] = {}
    with engine.open() as workers:
        while True:
            most = _AHEAD * max(workers.capacity(), 1)
            while not affected and len(under_way) < most and (case := next(waiting, None)) is not None:
                try:
                    under_way[workers.executor.submit(on_one_core, carry, case)] = case
                except BrokenExecutor:
                    affected.append(case)
            if not under_way:
                return affected
            done, _ = wait(under_way, timeout=_LOOK, return_when=FIRST_COMPLETED)
            if not done:
                workers.require_reachable()
            for future in done:
                case, row = under_way.pop(future), _result(future, engine)
                if row is None:
                    affected.append(case)
                else:
                    keep(row)


def _run_single(case: Case, engine: Engine, store: Store, carry: Carry, keep: Keep) -> None:
    """Execute a case without others, and set it aside after two deaths."""
    while True:
        with engine.open(1) as workers:
            row = _result(workers.executor.submit(on_one_core, carry, case), engine)
        if row is None and store.count_death(case.content_hash) >= _DEATHS:
            row = Row.of(
                case,
                Outcome.SET_ASIDE,
                f"{_DEATHS} workers died of {case.record} with nothing else to do, so it was set aside; look into the "
                "record, and into the worker's memory.",
            )
        if row is not None:
            keep(row)
            return


def _result(future: Future[Row], engine: Engine) -> Row | None:
    """Row of a case; None if its worker died."""
    try:
        return future.result()
    except JointidError:
        raise
    except Exception as error:
        if engine.is_death(error):
            return None
        raise RecordError(
            f"The workers gave a case up ({type(error).__name__}: {error}); see that they can be reached, and that "
            "each has this jointid and its extras, and give the same command again: what is finished is kept."
        ) from error


def on_one_core(carry: Carry, case: Case) -> Row:
    """Execute a case with one thread."""
    os.environ[THREADS] = "1"
    return carry(case)
