"""Small faults, put in one at a time: the quick tests must catch each.

``python -m tools.mutations`` runs the quick tests that `faults.toml` names for each fault, until the first failure, and
prints one line for each. Add ``--thorough`` to run all quick tests where those do not catch a fault. The working tree
stays as it is: each fault goes into a copy of its own, from which the tests import the package.

First the named tests run in a copy without a fault. What fails there cannot catch anything and is left out later. The
kernels that they compile go into the other copies. ``--trust`` leaves this run out.

To compare what is caught before and after a change of the tests::

    python -m tools.mutations --json before.json
    python -m tools.mutations --compare before.json

``--draw COUNT`` prints rows for the table instead: operators and numbers of the numerical rooms that are exchanged at
random places, with the quick tests of their room.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import tokenize
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tools" / "faults.toml"
PACKAGE = Path("src") / "jointid"
SEED = 0
"""Of the examples that property tests draw, so that two runs try the same ones."""

DRAWN = {
    "solvers": "tests/solvers", "models": "tests/models", "simulation": "tests/simulation",
    "estimation": "tests/estimation", "uncertainty": "tests/estimation",
}  # fmt: skip
"""Rooms in which faults are drawn, and the tests that should catch them."""
_EXCHANGED = {
    "+": "-", "-": "+", "*": "/", "/": "*", "<": ">", ">": "<", "<=": ">", ">=": "<", "==": "!=", "!=": "==",
    "and": "or", "or": "and", "True": "False", "False": "True", "0.5": "2.0", "2.0": "0.5", "1": "2", "1.0": "2.0",
}  # fmt: skip

_OPTIONS = ("-q", "-n", "0", "--no-header", "--tb=no", "-p", "no:cacheprovider", f"--hypothesis-seed={SEED}")
_LONGEST = 1800.0  # s; a fault may make a search endless
_COMPILED = "*.nb?"
_FAILURE = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault: what becomes what in a file of the package, and the tests that should catch it."""

    name: str
    file: str
    right: str
    wrong: str
    tests: tuple[str, ...]

    def put_into(self, copy: Path) -> None:
        """Put the fault into a copy of the project."""
        path = copy / PACKAGE / self.file
        path.write_text(path.read_text(encoding="utf-8").replace(self.right, self.wrong), encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Whether a fault is caught, by which test, and the seconds of processor that this took."""

    name: str
    file: str
    caught: bool
    by: str
    seconds: float

    def __str__(self) -> str:
        found = f"caught by {self.by}" if self.caught else "NOT CAUGHT"
        return f"{self.name} ({self.file}): {found} ({self.seconds:.1f} s)"


def read_faults(pattern: str = "") -> list[Fault]:
    """Return the faults of the table whose name or file has the pattern; exit if the table does not fit the tree."""
    table = tomllib.loads(TABLE.read_text(encoding="utf-8"))["faults"]
    every = [Fault(**(one | {"tests": tuple(one["tests"])})) for one in table]
    wrong = [f"{name} stands twice" for name in {one.name for one in every} if [o.name for o in every].count(name) > 1]
    for one in every:
        count = (ROOT / PACKAGE / one.file).read_text(encoding="utf-8").count(one.right)
        wrong += [] if count == 1 else [f"{one.name}: {one.file} has its text {count} times, expected once"]
        wrong += [f"{one.name}: there is no {test}" for test in one.tests if not (ROOT / test).exists()]
    if wrong:
        sys.exit("\n".join([*wrong, f"Correct {TABLE.relative_to(ROOT)}."]))
    return [one for one in every if re.search(pattern, f"{one.name} {one.file}")]


def draw_faults(count: int) -> list[Fault]:
    """Return faults at random places of the numerical rooms, as many for each room."""
    found: list[Fault] = []
    for room, tests in DRAWN.items():
        chosen = random.Random(f"{SEED} {room}")
        paths = sorted((ROOT / PACKAGE / room).rglob("*.py"))
        places = {(path, line): texts for path in paths for line, *texts in _exchanges(path)}  # one for each line
        for (path, line), (right, wrong) in chosen.sample(sorted(places.items()), count // len(DRAWN)):
            file = path.relative_to(ROOT / PACKAGE).as_posix()
            found.append(Fault(f"drawn in {file}, line {line}", file, right, wrong, (tests,)))
    return found


def _exchanges(path: Path) -> Iterator[tuple[int, str, str]]:
    """Yield each line of a file with one token exchanged: its number, its text and the faulty one, if it is unique."""
    text = path.read_text(encoding="utf-8")
    tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    for before, token, after in zip(tokens, tokens[1:], tokens[2:], strict=False):
        if token.string not in _EXCHANGED or before.string == "kw_only":
            continue
        operand = before.type in (tokenize.NAME, tokenize.NUMBER) or before.string in (")", "]")
        unary = token.string in ("*", "/") and not (operand and after.string not in (",", ")"))
        line = token.line.removesuffix("\n")
        if unary or text.count(line) > 1:
            continue
        wrong = line[: token.start[1]] + _EXCHANGED[token.string] + line[token.end[1] :]
        yield token.start[0], line, wrong


def copy_tree(target: Path) -> None:
    """Copy the files that git knows or might add, and the compiled kernels."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    kernels = (str(path.relative_to(ROOT)) for path in (ROOT / PACKAGE).rglob(_COMPILED))
    for name in (*listed.rstrip("\0").split("\0"), *kernels):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def environment(copy: Path) -> dict[str, str]:
    """Return the environment in which a copy is imported, not what is installed."""
    beside = {"JOINTID_DATA": str(ROOT.parent / "shared" / "data")} | os.environ
    beside |= {"PYTHONPATH": str(copy / "src"), "GIT_DIR": str(ROOT / ".git")}
    return {name: value for name, value in beside.items() if name != "NUMBA_CACHE_DIR"}


def run_tests(copy: Path, *chosen: str) -> tuple[list[str], float]:
    """Return the tests that fail in a copy, of those that are chosen, and the seconds of processor."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "pytest", *_OPTIONS, *chosen]
    try:
        ended = subprocess.run(
            command, cwd=copy, env=environment(copy), capture_output=True, text=True, timeout=_LONGEST, check=False
        )
    except subprocess.TimeoutExpired:
        failed = [f"no end within {_LONGEST:g} s"]
    else:
        failed = [f"signal {-ended.returncode}"] if ended.returncode < 0 else _FAILURE.findall(ended.stdout)
        if ended.returncode > 2 or (ended.returncode and not failed):
            raise RuntimeError(f"{' '.join(command)} ended with {ended.returncode}:\n{ended.stdout}{ended.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return failed, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def try_fault(base: Path, unsound: Sequence[str], thorough: bool, fault: Fault) -> Outcome:
    """Return whether the tests, but for those that fail without a fault, catch it in a copy of the project."""
    options = ["-x", *(f"--deselect={test}" for test in unsound)]
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "project"
        shutil.copytree(base, copy, ignore=shutil.ignore_patterns("*.pyc"))
        fault.put_into(copy)
        failed, seconds = run_tests(copy, *options, *fault.tests)
        if thorough and not failed:
            failed, more = run_tests(copy, *options, "tests")
            seconds += more
    return Outcome(fault.name, fault.file, bool(failed), failed[0] if failed else "", round(seconds, 1))


def find_unsound(base: Path, tests: Sequence[str]) -> list[str]:
    """Return the tests that fail in a copy without a fault; exit if they import another one."""
    program = "import jointid; print(jointid.__file__)"
    seen = subprocess.run(
        [sys.executable, "-c", program], cwd=base, env=environment(base), capture_output=True, text=True, check=True
    ).stdout.strip()
    if not Path(seen).is_relative_to(base):
        sys.exit(f"The tests import {seen}, expected the copy: take it off the paths that Python looks in first.")
    failed, seconds = run_tests(base, *tests)
    print(f"without a fault: {', '.join(failed) or 'nothing'} fails ({seconds:.1f} s)", flush=True)
    return failed


def compare(outcomes: Sequence[Outcome], former: Path) -> int:
    """Print the faults that a former run caught and this one missed, and return how many there are."""
    caught = {one["name"]: one["by"] for one in json.loads(former.read_text(encoding="utf-8")) if one["caught"]}
    lost = [one.name for one in outcomes if not one.caught and one.name in caught]
    for name in lost:
        print(f"no longer caught: {name}, formerly by {caught[name]}")
    return len(lost)


def main() -> None:
    """Run the faults; exit with 1 if one is missed, or with ``--compare`` if one is no longer caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="faults tried at once")
    parser.add_argument("--only", default="", metavar="PATTERN", help="regular expression, of names or files")
    parser.add_argument("--thorough", action="store_true", help="run all quick tests where those named catch nothing")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the outcomes there")
    parser.add_argument("--compare", type=Path, metavar="FILE", help="outcomes of a former run")
    parser.add_argument("--trust", action="store_true", help="leave out the run without a fault")
    parser.add_argument("--list", action="store_true", help="show the faults; fail if the table does not fit the code")
    parser.add_argument("--draw", type=int, metavar="COUNT", help="print rows of so many drawn faults")
    given = parser.parse_args()
    if given.draw:
        for fault in draw_faults(given.draw):
            rows = (f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in asdict(fault).items())
            print("[[faults]]", *rows, "", sep="\n")
        return
    faults = read_faults(given.only)
    if given.list:
        print("\n".join(f"{fault.file}: {fault.name}" for fault in faults))
        return
    outcomes = list[Outcome]()
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(given.jobs) as pool:
        base = Path(folder) / "project"
        copy_tree(base)
        tests = ["tests"] if given.thorough else sorted({test for fault in faults for test in fault.tests})
        unsound = [] if given.trust else find_unsound(base, tests)
        work = partial(try_fault, base, unsound, given.thorough)
        for done in as_completed([pool.submit(work, fault) for fault in faults]):
            outcomes.append(done.result())
            print(outcomes[-1], flush=True)
    order = {fault.name: place for place, fault in enumerate(faults)}
    outcomes.sort(key=lambda one: order[one.name])
    missed = sum(not one.caught for one in outcomes)
    seconds = sum(one.seconds for one in outcomes)
    print(f"{len(outcomes) - missed} of {len(outcomes)} caught, {seconds:.0f} s of processor")
    if given.json:
        given.json.write_text(json.dumps([asdict(one) for one in outcomes], indent=1) + "\n", encoding="utf-8")
    sys.exit(1 if (compare(outcomes, given.compare) if given.compare else missed) else 0)


if __name__ == "__main__":
    main()
