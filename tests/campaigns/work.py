"""Cases that take no time, and what carries them out: it notes each case that it ends, and dies of a poisonous one."""

import os
import signal
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from jointid.campaigns.campaign import Case
from jointid.campaigns.run import Engine, Found, Outcome, Row, local_processes, open_store, run_cases

PLAIN, POISON, SLOW = "", "poison", "slow"


def cases(count: int, log: Path, kinds: dict[int, str] | None = None) -> Iterator[Case]:
    """Yield cases that note their ends in a file; a kind says by number what happens to whoever takes one."""
    for number in range(count):
        kind = (kinds or {}).get(number, PLAIN)
        yield Case(f"axis {number}", "", str(log), "", changes=(kind,))


def carry(case: Case) -> Row:
    if case.changes == (POISON,):
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(2.0 if case.changes == (SLOW,) else 0.01)
    with Path(case.record).open("ab", 0) as log:
        log.write(f"{case.content_hash} {os.getpid()}\n".encode())
    found = {"stiffness": Found(float(int(case.content_hash[:8], 16)), 1.0, "N/m")}
    return Row.of(case, Outcome.IDENTIFIED, "Stiffness found.", found=found)


TWO: Engine = partial(local_processes, count=2)


def run_all(
    path: Path, log: Path, count: int, engine: Engine, kinds: dict[int, str] | None = None
) -> dict[Outcome, int]:
    """Run a campaign of such cases with its results in a file, and return how many ended how."""
    with open_store(path) as store:
        return run_cases(cases(count, log, kinds), engine, store, carry=carry)


def results(path: Path, log: Path, count: int, kinds: dict[int, str] | None = None) -> tuple[Row, ...]:
    """Return the results of such a campaign."""
    with open_store(path) as store:
        return store.rows_of(case.content_hash for case in cases(count, log, kinds))


def ends(log: Path) -> list[str]:
    """Return the hashes of the cases that came to their end, in order."""
    return [line.split()[0] for line in _lines(log)]


def last_workers(log: Path) -> list[int]:
    """Return the processes that came to the last ends."""
    return [int(line.split()[1]) for line in _lines(log)[-4:]]


def _lines(log: Path) -> list[str]:
    return log.read_text(encoding="utf-8").splitlines() if log.exists() else []


def main(path: str, log: str, count: str) -> None:
    """Run a campaign."""
    run_all(Path(path), Path(log), int(count), TWO)


if __name__ == "__main__":
    main(*sys.argv[1:])
