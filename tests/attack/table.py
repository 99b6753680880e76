"""All attacks, and what came of them as a table: ``JOINTID_ATTACKS=20 python -m tests.attack.table``.

The tests assert that nothing is lost, cut or executed, and that no traceback is printed. Here they are counted. Parts
of file names as arguments choose.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

from tests.losses.runs import COUNT

PARTS: dict[str, dict[str, str]] = {
    "tests/losses/test_surroundings.py": {
        "the_first_second_of": "kills in the first second of commands",
        "campaign_on_a_full_disk": "sizes of a full disk under a campaign and its reports",
        "folder_that_takes_nothing": "writers into a read-only folder",
        "reader_that_is_killed": "readings while the reading process is killed",
    },
    "tests/losses/test_signals.py": {
        "at_any_moment": "kills of commands at random moments",
        "program_is_loaded": "Ctrl-C while the program is loaded",
    },
    "tests/losses/test_full_disk.py": {"": "sizes of a full disk under writers"},
    "tests/apps/web/test_full_disk.py": {"": "requests to the page on a full disk"},
    "tests/apps/web/test_hostile_requests.py": {"": "hostile requests to the page"},
    "tests/apps/web/test_damaged_folder.py": {"": "damaged folders of the page"},
    "tests/campaigns/test_losses.py": {
        "first_worker": "kills while the first worker of a campaign starts",
        "client_or_a_shard": "kills of clients and shards",
        "workers_that_are_killed": "kills of workers",
    },
    "tests/campaigns/test_dask.py": {
        "second_client": "kills of a client over Dask while a second waits",
        "at_any_moment": "kills of workers and schedulers of Dask",
    },
    "tests/campaigns/test_foreign_folder.py": {"": "campaign folders from somebody else"},
    "tests/config/test_hostile_text.py": {"": "hostile joint files and models"},
    "tests/test_hostile.py": {"": "hostile records, joint files and answers"},
    "tests.attack": {"": "readings of mutated and hand-made files"},
}
"""What is counted, by file and a part of the test's name. Without notes of its own a test counts as one attack."""


def attack(part: str, notes: Path) -> tuple[dict[str, tuple[int, float]], list[str], int]:
    """Run a part; return number and longest time by test, the tests that failed, and the most memory of a process."""
    command = ["-m", "pytest", "-n", "0", "-q", "-m", "", "-rpf", "-k", " or ".join(filter(None, PARTS[part])), part]
    if part == "tests.attack":
        command = ["-m", part, "--mutated", str(50 * COUNT), "--every", str(max(240 // COUNT, 1)), "--seed", str(COUNT)]
    with tempfile.TemporaryFile("w+") as output:
        started = subprocess.Popen(
            [sys.executable, *command], stdout=output, stderr=subprocess.STDOUT,
            env={**os.environ, "JOINTID_ATTACKS_NOTES": str(notes), "COLUMNS": "500"},
        )  # fmt: skip
        _, status, used = os.wait4(started.pid, 0)
        started.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        said = output.read()
    ended = re.findall(r"^(PASSED|FAILED|ERROR) \S+::(.*)$", said, re.MULTILINE)
    found = {name: (1, 0.0) for outcome, name in ended if outcome == "PASSED"}
    failed = [name for outcome, name in ended if outcome != "PASSED"]
    if started.returncode and not failed:
        failed = [said[-300:]]
    counted, longest = Counter[str](), defaultdict[str, float](float)
    for line in notes.read_text(encoding="utf-8").splitlines() if notes.exists() else ():
        count, seconds, name = line.split(" ", 2)
        counted[name] += int(count)
        longest[name] = max(longest[name], float(seconds))
    return found | {name: (counted[name], longest[name]) for name in counted}, failed, used.ru_maxrss


def main() -> None:
    """Print a row for each kind of attack, and the failures after them."""
    print(
        "| attacks | tried | tracebacks, lost, cut, executed | longest (s) | most memory (GB) |\n|---|---|---|---|---|"
    )
    bad = list[str]()
    for part, rows in PARTS.items():
        if sys.argv[1:] and not any(word in part for word in sys.argv[1:]):
            continue
        with tempfile.TemporaryDirectory() as folder:
            tried, failed, memory = attack(part, Path(folder) / "notes")
        bad += failed
        for key, what in rows.items():
            mine = [value for name, value in tried.items() if key in name]
            count, longest = sum(one for one, _ in mine), max((seconds for _, seconds in mine), default=0.0)
            lost = sum(key in name for name in failed)
            time = f"{longest:.1f}" if longest else "-"
            print(f"| {what} | {count} | {lost} | {time} | {memory / 2**20:.1f} |", flush=True)
    print(*bad, sep="\n")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
