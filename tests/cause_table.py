"""The table of mistakes against what is named: `python -m tests.cause_table AXIS SEED [PART OF A NAME]`."""

from __future__ import annotations

import sys
import time

from tests.mistakes import PAIRS, axis, is_misled, mistakes_of, more_mistakes_of, tell, without_positions

if __name__ == "__main__":
    made = axis(sys.argv[1])  # type: ignore[arg-type]
    part = sys.argv[3] if len(sys.argv) > 3 else ""
    counts = {"right": 0, "none": 0, "wrong": 0}
    for mistake in (*mistakes_of(made), *more_mistakes_of(made), *PAIRS):
        if part not in mistake.name:
            continue
        record, loop = mistake.make(made, int(sys.argv[2]))
        record = without_positions(record) if mistake in PAIRS else record
        begin = time.perf_counter()
        named, words = tell(record, loop)
        right = "right" if mistake.right & set(named) and mistake.said in words else "none"
        right = "wrong" if is_misled(mistake, named, words) else right
        counts[right] += 1
        took = time.perf_counter() - begin
        print(
            f"| {sys.argv[1]} | {mistake.name} | {right} | {', '.join(named)} | {took:.1f} s | {words[:400]} |",
            flush=True,
        )
    print(sys.argv[1], counts)
