"""Ten faults in the solvers and the problems, put in one at a time: the default tests must catch each.

``python -m tools.mutations`` changes a file, runs the default tests of the solvers and the problems until the first
failure, puts the file back, and prints one line for each fault. A clean tree is asked for; an interrupt puts the file
back, too.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "jointid"

FAULTS = (
    ("the trust region's Jacobian in wrong units", "solvers/bounded_least_squares.py", "[1] * (unit / size)",
     "[1] * size"),
    ("a larger damping after a step that went down", "solvers/bounded_least_squares.py", "_EASIER, _HARDER = 0.1, 5.0",
     "_EASIER, _HARDER = 50.0, 5.0"),
    ("Gauss-Newton goes uphill", "solvers/gauss_newton.py", "at.x - solution(", "at.x + solution("),
    ("instruments step uphill", "solvers/regression.py", "-projection(", "projection("),
    ("the worst of several starts", "solvers/solve.py", "np.argmin(costs)", "np.argmax(costs)"),
    ("Nelder-Mead minimises the norm of nothing", "solvers/nelder_mead.py", "return norm * norm", "return 0.0 * norm"),
    ("upper bounds are not kept", "common/parameters.py", "np.minimum(np.maximum(x, self.lower), self.upper)",
     "np.maximum(x, self.lower)"),
    ("the closed loop's derivatives with the wrong sign", "estimation/problems/closed_loop.py",
     "return error, -slopes", "return error, slopes"),
    ("several records: a known inertia is taken off", "estimation/problems/base.py",
     "x[self.places[number]] + self.added[number]", "x[self.places[number]] - self.added[number]"),
    ("a fixed parameter counts as free", "estimation/problems/base.py", "for p in self.parameters if p.free)",
     "for p in self.parameters)"),
)  # fmt: skip
"""Name, file, and what becomes what in it."""

TESTS = (
    "tests/solvers", "tests/estimation/test_problem_base.py", "tests/estimation/test_sum_problem.py",
    "tests/estimation/test_recovery.py", "tests/estimation/test_several_records.py",
    "tests/estimation/test_flexible.py",
)  # fmt: skip
"""Of the default tests, those of the solvers and the problems."""


def main() -> None:
    """Run every fault, and exit with 1 if one was not caught."""
    missed = 0
    for name, file, right, wrong in FAULTS:
        path = SOURCE / file
        text = path.read_text(encoding="utf-8")
        if text.count(right) != 1:
            sys.exit(f"{file} has {text.count(right)} times {right!r}; expected once: correct the table of faults.")
        began = time.perf_counter()
        path.write_text(text.replace(right, wrong), encoding="utf-8")
        try:
            command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "--no-header", "-p", "no:cacheprovider"]
            ended = subprocess.run([*command, *TESTS], cwd=ROOT, capture_output=True, text=True, check=False)
        finally:
            path.write_text(text, encoding="utf-8")
        failed = [line for line in ended.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
        missed += ended.returncode != 1
        caught = failed[0].split(" - ")[0].split()[-1] if ended.returncode == 1 and failed else f"rc {ended.returncode}"
        print(f"{name}: {'caught by' if ended.returncode == 1 else 'NOT CAUGHT,'} {caught}"
              f" ({time.perf_counter() - began:.0f} s)", flush=True)  # fmt: skip
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
