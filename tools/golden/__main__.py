"""`python -m tools.golden write FILE`, `python -m tools.golden check [FILE]`: freeze the numbers, or compare them."""

from __future__ import annotations

import argparse
import json
import os
import sys
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read once, when NumPy is loaded: the order of sums depends on it
os.environ.setdefault("MKL_NUM_THREADS", "1")

from tools.golden.cases import CASES
from tools.golden.comparing import differences
from tools.golden.running import run

STORED = Path(__file__).with_name("golden.json")


def main(arguments: list[str] | None = None) -> int:
    """Run the cases and write or compare their numbers; 1 where one is another."""
    parser = argparse.ArgumentParser(prog="python -m tools.golden", description=__doc__)
    parser.add_argument("what", choices=("write", "check", "list"))
    parser.add_argument("file", nargs="?", type=Path, default=STORED)
    parser.add_argument("--only", metavar="PATTERN", help="cases whose name matches, as 'emps_*', or contains the word")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="cases that run at a time")
    given = parser.parse_args(arguments)
    chosen = [name for name in CASES if given.only is None or _matches(name, given.only)]
    if given.what == "list":
        print("\n".join(chosen))
        return 0
    stored: dict[str, Any] = json.loads(given.file.read_text(encoding="utf-8")) if given.file.is_file() else {}
    if given.what == "check" and not stored:
        print(f"there is nothing to compare with in {given.file}")
        return 1
    found, broken = run(chosen, given.jobs)
    if given.what == "check":
        return _compared(stored, found, chosen) or int(broken)
    kept = {name: numbers for name, numbers in stored.items() if name not in chosen} if given.only else {}
    given.file.write_text(_text(kept | found), encoding="utf-8")
    print(f"{len(found)} cases written to {given.file}")
    return int(broken)


def _text(found: dict[str, Any]) -> str:
    """Return numbers as JSON, sorted, with a line for each part of a case."""

    def compact(value: Any) -> str:
        return json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=False, separators=(",", ":"))

    def case(parts: Any) -> str:
        if not isinstance(parts, dict):
            return compact(parts)
        return "{\n " + ",\n ".join(f"{compact(key)}: {compact(part)}" for key, part in sorted(parts.items())) + "\n}"

    return "{\n" + ",\n".join(f"{compact(name)}: {case(parts)}" for name, parts in sorted(found.items())) + "\n}\n"


def _matches(name: str, pattern: str) -> bool:
    return fnmatchcase(name, pattern) or pattern in name


def _compared(stored: dict[str, Any], found: dict[str, Any], chosen: list[str]) -> int:
    """Print every difference and return 1 where one counts."""
    apart = [one for name in sorted(found) if name in stored for one in differences(stored[name], found[name], name)]
    lines = [one.text for one in apart if not one.reason]
    lines += [f"{name}: not in the stored numbers" for name in found if name not in stored]
    lines += [f"{name}: stored, but no case has this name" for name in stored if name not in CASES]
    rounded = [f"{one.text} (another rounding: {one.reason})" for one in apart if one.reason]
    print("\n".join([*rounded, *lines]))
    print(f"{len(found)} of {len(chosen)} cases compared: {len(lines)} differences, {len(rounded)} of another rounding")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
