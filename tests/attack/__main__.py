"""The whole attack, or a part of it: ``python -m tests.attack --mutated 10000 --seed 1``.

Prints what came of all files, and ends with 1 if one came to something else than numbers or sentences. A file that
failed is kept in the folder that is printed; the same seed makes the same files.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from tests.attack.attacking import OUTCOMES, Tally
from tests.attack.by_hand import make_hostile
from tests.attack.mutations import mutate
from tests.attack.samples import Sample, make_samples


def attack(samples: Iterator[Sample], folder: Path, tally: Tally, *, every: int = 1, part: int = 0) -> int:
    """Attack with files, or with one in so many; return how many there were. Those that fail are kept."""
    count = 0
    for number, sample in enumerate(samples):
        if number % every != part:
            continue
        count += 1
        suffix = Path(sample.name).suffix
        path, failed = folder / f"attack{suffix}", len(tally.failures)
        path.write_bytes(sample.content)
        tally.attack(sample.reader, path, sample.name)
        if len(tally.failures) > failed:
            path.replace(folder / f"failed {len(tally.failures)}{suffix}")
            print(tally.failures[-1], flush=True)
    return count


def mutated(samples: list[Sample], count: int, seed: int) -> Iterator[Sample]:
    """Yield so many mutated files, of every sample in turn."""
    chance, contents = random.Random(seed), [sample.content for sample in samples]
    for number in range(count):
        sample = samples[number % len(samples)]
        suffix = Path(sample.name).suffix
        yield Sample(
            sample.reader, f"mutation {number} of {sample.name}{suffix}", mutate(sample.content, contents, chance)
        )


def main() -> int:
    """Attack, and return the exit code."""
    arguments = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    arguments.add_argument("--mutated", type=int, default=10_000, help="mutated files")
    arguments.add_argument("--every", type=int, default=1, help="of so many files made by hand one is taken; 0: none")
    arguments.add_argument("--part", type=int, default=0, help="of so many files made by hand: which, from 0")
    arguments.add_argument("--seed", type=int, default=1, help="of the mutations")
    given = arguments.parse_args()
    folder, tally, begin = Path(tempfile.mkdtemp(prefix="attack")), Tally(), time.monotonic()
    (folder / "sound").mkdir()
    samples = make_samples(folder / "sound")
    hostile = make_hostile(folder / "sound")
    by_hand = attack(hostile, folder, tally, every=given.every, part=given.part) if given.every else 0
    tally.judge_memory()
    changed = attack(mutated(samples, given.mutated, given.seed), folder, tally)
    tally.judge_memory()
    said = ", ".join(f"{tally.outcomes[outcome]} {outcome}" for outcome in (*OUTCOMES, "failed"))
    slowest, name = tally.slowest
    print(f"{changed} mutated files and {by_hand} made by hand, seed {given.seed}: {said}")
    print(f"in {time.monotonic() - begin:.0f} s; the slowest took {slowest:.1f} s ({name}); {folder}")
    return bool(tally.failures)


if __name__ == "__main__":
    sys.exit(main())
