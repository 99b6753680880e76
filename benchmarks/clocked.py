"""A case that is carried out with a clock beside it: what a worker spends on it, whatever others use the machine."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from pathlib import Path

from jointid.campaigns.cases import Case, Row
from jointid.campaigns.run import run_case


def clocked(log: Path, case: Case) -> Row:
    """Carry out a case, and note how much of a core this process has spent by its end."""
    row = run_case(case)
    with log.open("a", encoding="ascii") as file:
        file.write(f"{os.getpid()} {time.process_time()}\n")
    return row


def core_seconds(log: Path) -> tuple[float, int]:
    """Return the seconds of a core between the first end and the last of each process, and of how many cases."""
    ends = defaultdict[str, list[float]](list)
    for line in log.read_text(encoding="ascii").splitlines():
        process, seconds = line.split()
        ends[process].append(float(seconds))
    return sum(one[-1] - one[0] for one in ends.values()), sum(len(one) - 1 for one in ends.values())
