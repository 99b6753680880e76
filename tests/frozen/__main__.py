"""Compare what the package answers with what it answered when the answers were frozen.

``python -m tests.frozen [PATTERN]`` runs all cases, or those whose name has the pattern, on two cores.
``--draw COMMIT`` runs a twentieth of them, drawn by the commit. ``--accept NAME`` writes the answer of one case anew,
and asks for the reason, which is kept beside it. ``--new`` adds the answers of cases that have none yet.

An answer is: values with deviations, the trust in the answer (or the refusal), the bound of a stiffness that is
refused, and the first cause that is named. Two answers agree if values lie within a tenth of a deviation and deviations
within 5 % (real records: 1e-6 of the value), and if trust and first cause are equal.
"""

import argparse
import hashlib
import json
import os
import platform
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a second thread of linear algebra only waits for the first
if platform.machine() in ("x86_64", "AMD64"):
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")  # which rounds as where the answers were frozen

from tests.frozen.answers import differences, run_case
from tests.frozen.cases import DATA, every

ANSWERS = Path(__file__).with_name("answers.json")
SHARE = 20  # one case of so many is drawn


def drawn(names: list[str], commit: str) -> list[str]:
    """Return a twentieth of the cases, drawn by a commit."""
    place = {name: hashlib.sha256(f"{commit} {name}".encode()).hexdigest() for name in names}
    return sorted(names, key=place.__getitem__)[: -(-len(names) // SHARE)]


def main() -> int:
    """Run the cases that are asked for, and return how many differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pattern", nargs="?", default="", help="a part of the names")
    parser.add_argument("--draw", default="", metavar="COMMIT", help="run a twentieth, drawn by a commit")
    parser.add_argument("--accept", default="", metavar="NAME", help="write the answer of this case anew")
    parser.add_argument("--new", action="store_true", help="add the answers of cases that have none")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    kept: dict[str, Any] = json.loads(ANSWERS.read_text(encoding="utf-8")) if ANSWERS.exists() else {}
    cases = dict(every())
    if lost := kept.keys() - cases.keys():
        sys.exit(f"Answers without a case: {', '.join(sorted(lost))}; remove them from {ANSWERS.name}.")
    names = [name for name in cases if given.pattern in name]
    if given.accept:
        names = [given.accept]
    elif given.new:
        names = [name for name in names if name not in kept]
    if given.draw:
        names = drawn(names, given.draw)
    needed = {"real": DATA, "file": DATA.parent / "cases", "robot 0 rigid urdf": DATA.parent / "cases"}
    missing = [name for name in names for of, place in needed.items() if name.startswith(of) and not place.is_dir()]
    for name in missing:
        print(f"{name}: skipped, its files are not there")
    reason = input(f"Why does {given.accept} change? ").strip() if given.accept else ""
    if given.accept and not reason:
        sys.exit("An answer is accepted with its reason; nothing is written.")
    differ, used = 0, 0.0
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        if needed["file"].is_dir():
            shutil.copytree(DATA.parent / "cases", Path(folder) / "frozen-cases", copy_function=shutil.copyfile)
            for path in Path(folder).rglob("*"):
                path.chmod(0o755)
        waiting = [pool.submit(run_case, name, folder) for name in names if name not in missing]
        for place, done in enumerate(as_completed(waiting), 1):
            name, answer, seconds = done.result()
            used += seconds
            if given.new or given.accept:
                kept[name] = answer | ({"reason": reason} if reason else {})
                ANSWERS.write_text(to_text(kept), encoding="utf-8")
            found = differences(name, kept[name], answer) if name in kept else ["it has no answer yet; give --new"]
            differ += bool(found)
            print(f"[{place}/{len(waiting)}] {name}: {'; '.join(found) or 'equal'} ({seconds:.1f} s)", flush=True)
    print(f"{len(waiting) - differ} of {len(waiting)} equal, {used:.0f} s of processor")
    return min(differ, 1)


def to_text(answers: dict[str, Any]) -> str:
    """Return the answers as JSON, a line for each case."""
    lines = [f"{json.dumps(name)}: {json.dumps(answers[name])}" for name in sorted(answers)]
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    sys.exit(main())
