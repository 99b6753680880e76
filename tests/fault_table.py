"""The table of true faults against those named: `python -m tests.fault_table LOOP NOISE RUNS single|pairs`."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence

from jointid.estimation.suspects import LoopTests, suspected
from tests.faults import FAULTS, PAIRS, Loop, Noise, on, problem, setting, solved


def named(name: Loop, fault: str | None, noise: Noise, seed: int) -> tuple[str, ...]:
    """What is named of one run of the twin, in order, two at most."""
    where = setting(name)
    made = problem(where, on(name, fault) if fault else None, noise, seed)
    found = suspected(made, solved(made, where, 1e-5), LoopTests(most=2)).findings
    return tuple(f.suspect.name for f in found)


def counted(name: Loop, fault: str | None, noise: Noise, seeds: Sequence[int]) -> Counter[tuple[str, ...]]:
    """How often each answer came."""
    return Counter(named(name, fault, noise, seed) for seed in seeds)


def lines(name: Loop, noise: Noise, seeds: Sequence[int], faults: Sequence[str]) -> Iterator[str]:
    """The rows of the table, in Markdown, one by one."""
    runs = len(seeds)
    for fault in faults:
        found = counted(name, fault, noise, seeds)
        top: Counter[str] = Counter()
        for answer, times in found.items():
            top[answer[0] if answer else "nothing"] += times
        true = set(fault.split(", "))
        right = sum(times for answer, times in found.items() if set(answer[: len(true)]) == true)
        more = sum(times for answer, times in found.items() if len(answer) > len(true))
        share = ", ".join(f"{suspect} {times}" for suspect, times in top.most_common())
        yield f"| {name} {noise} | {fault} | {100 * right / runs:.1f} | {100 * more / runs:.1f} | {share} |"


if __name__ == "__main__":
    chosen = {"single": FAULTS, "pairs": PAIRS}[sys.argv[4]]
    for line in lines(sys.argv[1], sys.argv[2], range(1, 1 + int(sys.argv[3])), tuple(chosen)):  # type: ignore[arg-type]
        print(line, flush=True)
