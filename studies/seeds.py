"""Seeds judged as a campaign: on all cores, each outcome kept as it comes, so that a study may be interrupted."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from jointid.campaigns.cases import Case, Outcome, Row, Simulated, canonical
from jointid.campaigns.engines import LocalProcesses
from jointid.campaigns.folder import read_results
from jointid.campaigns.run import run_cases
from jointid.campaigns.store import open_database


@dataclass(frozen=True, slots=True)
class Task:
    """One seed of a study: a function as "module:name", its seed and its other arguments."""

    function: str
    seed: int
    settings: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Judged:
    """The outcome of a task as JSON has it, and the seconds of the processor that it took."""

    outcome: Any
    seconds: float


def judge_tasks(tasks: Sequence[Task], out: Path | None = None) -> list[Judged]:
    """Judge tasks in parallel.

    Args:
        tasks: to be judged; the functions return a dataclass, plain values or None.
        out: folder in which outcomes are kept and found again; a temporary one when None.
    """
    cases = [
        Case(one.function, "", "", "", changes=(canonical(one.settings),), varied=Simulated((), seed=one.seed))
        for one in tasks
    ]
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory())) if out is None else out
        folder.mkdir(parents=True, exist_ok=True)
        with open_database(folder) as database:
            run_cases(lambda: cases, LocalProcesses(), database, name="studies", carry=_carry, progress=_say)
        rows = {row.content_hash: row for row in read_results(folder).rows}
    return [Judged(**json.loads(rows[case.content_hash].sentence)) for case in cases]


def judge_seeds(
    function: str, seeds: Iterable[int], *settings: Mapping[str, Any], out: Path | None = None
) -> Iterator[Any]:
    """Yield the outcome of each seed in order, as JSON has it, without those that are None.

    Args:
        function: of a seed and the settings, as "studies.mechanics:judge".
        seeds: judged with each of the settings.
        settings: the function's other arguments, as JSON has them; of several all seeds of the first come first.
        out: folder in which outcomes are kept and found again; a temporary one when None.
    """
    numbers = list(seeds)
    tasks = [Task(function, seed, one) for one in settings for seed in numbers]
    yield from (one.outcome for one in judge_tasks(tasks, out) if one.outcome is not None)


def _carry(case: Case) -> Row:
    """Return a case's outcome and its seconds, as JSON in the place of a row's sentence."""
    module, _, name = case.joint.partition(":")
    assert isinstance(case.varied, Simulated)
    function, began = getattr(import_module(module), name), time.process_time()
    found = function(case.varied.seed, **json.loads(case.changes[0]))
    outcome = asdict(found) if is_dataclass(found) and not isinstance(found, type) else found
    said = {"outcome": outcome, "seconds": time.process_time() - began}
    return Row.of(case, Outcome.IDENTIFIED, json.dumps(said, sort_keys=True))  # a margin may be infinite


def parse_seeds(about: str | None, count: int, *more: str) -> argparse.Namespace:
    """Return what a study is asked for: `seeds`, a range of so many unless told, `out`, and flags by their names."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("seeds", nargs="*", type=int, metavar="FIRST AFTER_LAST")
    parser.add_argument("--out", type=Path, help="folder in which results are kept, and found when it is given again")
    for flag in more:
        parser.add_argument(f"--{flag}", action="store_true")
    given = parser.parse_args()
    if len(given.seeds) not in (0, 2):
        parser.error("expected two numbers, the first seed and the one after the last")
    given.seeds = range(*(given.seeds or (0, count)))
    return given


def _say(said: str) -> None:
    sys.stderr.write(f"{said}\n")
