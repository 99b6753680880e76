"""The table of true faults against those named: `python -m tests.fault_table LOOP NOISE RUNS single|pairs`."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence

from jointid.diagnostics.check_loop import LoopTests, find_faults
from jointid.diagnostics.fault_tests import rank_tests
from tests.faults import FAULTS, PAIRS, Loop, Noise, on, problem, setting, solved

LEVEL = 0.05
NOTHING = "nothing"


def named(name: Loop, fault: str | None, noise: Noise, seed: int) -> tuple[str, ...]:
    """What is named of one run of the twin, two at most, in order."""
    where = setting(name)
    made = problem(where, on(name, fault) if fault else None, noise, seed)
    found = find_faults(made, solved(made, where, 1e-4), LoopTests(most=2)).findings
    return tuple(f.test.name for f in found)


def first_named(name: Loop, fault: str | None, noise: Noise, seed: int) -> str:
    """What is named first; at a fraction of the cost, since nothing is solved again."""
    where = setting(name)
    made = problem(where, on(name, fault) if fault else None, noise, seed)
    top = rank_tests(find_faults(made, solved(made, where, 1e-4), LoopTests(level=1e-300)).tests, LEVEL)[0]
    return top.name if top.p_value <= LEVEL else NOTHING


def singles(name: Loop, noise: Noise, seeds: Sequence[int]) -> Iterator[str]:
    """The rows of single faults, in Markdown, one by one."""
    for fault in FAULTS:
        found = Counter(first_named(name, fault, noise, seed) for seed in seeds)
        others = ", ".join(f"{suspect} {times}" for suspect, times in found.most_common() if suspect != fault)
        yield f"| {name} {noise} | {fault} | {100 * found[fault] / len(seeds):.1f} | {others or '-'} |"


def pairs(name: Loop, noise: Noise, seeds: Sequence[int]) -> Iterator[str]:
    """The rows of pairs, in Markdown: both named, the first of those named is one of them, both and in which order."""
    for fault in PAIRS:
        found = Counter(named(name, fault, noise, seed) for seed in seeds)
        true = set(fault.split(", "))
        both = sum(times for answer, times in found.items() if set(answer) == true)
        one = sum(times for answer, times in found.items() if answer and answer[0] in true)
        others = ", ".join(
            f"{' then '.join(answer) or NOTHING} {times}"
            for answer, times in found.most_common()
            if set(answer) != true
        )
        yield f"| {fault} | {100 * one / len(seeds):.0f} | {100 * both / len(seeds):.0f} | {others or '-'} |"


if __name__ == "__main__":
    rows = {"single": singles, "pairs": pairs}[sys.argv[4]]
    for row in rows(sys.argv[1], sys.argv[2], range(1, 1 + int(sys.argv[3]))):  # type: ignore[arg-type]
        print(row, flush=True)
