"""How long commands take to start: interpreters of their own, in turn, beside what they cannot do without.

    python benchmarks/startup.py [--rounds N]

Prints a table of medians. Real time counts, and so does how long a process takes to end. What is compared with runs in
the same rounds, because a shared machine is slow now and then. Bytecode is compiled first, as it is where a package is
installed. EMPS needs the real records (`JOINTID_DATA`); the row of an empty compile cache is run once.
"""

from __future__ import annotations

import argparse
import compileall
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import jointid

HERE = Path(__file__).resolve().parent
PACKAGE = Path(jointid.__file__).parent
LIBRARIES = "import numpy, scipy.linalg, scipy.optimize, scipy.signal, scipy.special, scipy.stats"
COMMAND = "from jointid.apps.cli import main; main()"


def emps() -> Path | None:
    """The EMPS record, found as the tests find it."""
    named = os.environ.get("JOINTID_DATA")
    places = [Path(named)] if named else []
    places.append(HERE.parents[1] / "shared" / "data")
    return next((p / "emps" / "DATA_EMPS.mat" for p in places if (p / "emps" / "DATA_EMPS.mat").is_file()), None)


def seconds(arguments: Sequence[str], **changed: str) -> tuple[float, str]:
    """Run one interpreter; return how long it took, and what it said of its progress."""
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", *arguments], cwd=HERE.parent, env={**os.environ, **changed}, check=True,
        capture_output=True, text=True,
    )  # fmt: skip
    return time.perf_counter() - begun, done.stderr


def in_turn(cases: Mapping[str, Sequence[str]], rounds: int) -> dict[str, list[float]]:
    """Return the times of each case; a round before the first is not counted."""
    found: dict[str, list[float]] = {name: [] for name in cases}
    for number in range(rounds + 1):
        for name, arguments in cases.items():
            took, _ = seconds(arguments)
            if number:
                found[name].append(took)
    return found


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    rounds = parser.parse_args().rounds
    compileall.compile_dir(PACKAGE, quiet=2)
    record, joint = emps(), HERE.parent / "examples" / "emps" / "joint.toml"
    identify = [COMMAND, "identify", str(joint), "--record", str(record)]
    cases = {
        "interpreter": ["pass"],
        "`import jointid`": ["import jointid"],
        "`import cyclopts`": ["import cyclopts"],
        "`jointid --help`": [COMMAND, "--help"],
        "`import` NumPy and SciPy": [LIBRARIES],
    } | ({"`jointid identify` on EMPS": identify} if record else {})
    found = {name: statistics.median(times) for name, times in in_turn(cases, rounds).items()}
    beyond = {
        "`import jointid`": "interpreter",
        "`jointid --help`": "`import cyclopts`",
        "`jointid identify` on EMPS": "`import` NumPy and SciPy",
    }
    print("| | s, median | over | by s |\n|---|---|---|---|")
    for name, took in found.items():
        base = beyond.get(name)
        more = f"{base} | {took - found[base]:.3f}" if base else " | "
        print(f"| {name} | {took:.3f} | {more} |")
    if record:
        with tempfile.TemporaryDirectory() as empty:
            took, said = seconds(identify, NUMBA_CACHE_DIR=empty)
        print(f"| the same, nothing compiled yet | {took:.1f} | | |")
        print("\nIt said why:", next(line for line in said.splitlines() if "compiling" in line))
    print(f"\n{rounds} rounds; Python {sys.version.split()[0]}.")


if __name__ == "__main__":
    main()
