"""Outcomes of all studies in `docs/studies.json`, and the table of the documentation that is made of them."""

from __future__ import annotations

import datetime
import json
import os
import platform
import re
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from studies.study import Share, Study, counted

ROOT = Path(__file__).resolve().parents[1]
STORED = ROOT / "docs" / "studies.json"


@dataclass(frozen=True, slots=True)
class Program:
    """The program that made outcomes.

    Attributes:
        commit: of the working tree. clean: whether the tree was that commit, but for the documentation.
        date: of the run. processor: its model.
    """

    commit: str
    clean: bool
    date: str
    processor: str

    @classmethod
    def here(cls) -> Program:
        """Return this program, now, on this machine."""
        commit, changed = _git("rev-parse", "HEAD"), _git("status", "--porcelain", "--", ".", ":!docs")
        return cls(commit, not changed, datetime.datetime.now(datetime.UTC).date().isoformat(), _processor())


@dataclass(frozen=True, slots=True)
class Entry:
    """A study that was run.

    Attributes:
        program: that made the outcomes.
        seeds: judged with each of the settings.
        settings: how many.
        seconds: of the processor, together.
        shares: letters of the tasks in their order, by share; see `Study.count`.
    """

    program: Program
    seeds: tuple[int, ...]
    settings: int
    seconds: float
    shares: Mapping[str, str]

    def is_of(self, study: Study) -> bool:
        """Return whether the study still has these tasks and shares."""
        labels = [share.label for share in study.shares]
        return (self.seeds, self.settings, [*self.shares]) == (tuple(study.seeds), len(study.settings), labels)


def read_entries(path: Path = STORED) -> dict[str, Entry]:
    """Return the stored studies by name."""
    if not path.exists():
        return {}
    found = json.loads(path.read_text(encoding="utf-8"))
    return {name: _entry(one) for name, one in found.items()}


def write_entries(entries: Mapping[str, Entry], path: Path = STORED) -> None:
    """Write the stored studies, with the counts of each share beside its letters."""
    document = {}
    for name, entry in entries.items():
        shares = {
            label: {"held": counted(letters)[0], "of": counted(letters)[1], "each": letters}
            for label, letters in entry.shares.items()
        }
        document[name] = {
            **asdict(entry.program), "seeds": _said(entry.seeds), "settings": entry.settings,
            "seconds": round(entry.seconds, 1), "shares": shares,
        }  # fmt: skip
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def make_table(studies: Iterable[Study], entries: Mapping[str, Entry]) -> str:
    """Return the table of the tested shares of all studies in Markdown."""
    rows = ["| study | share | holds in | stated, % |", "|---|---|---|---|"]
    for study in studies:
        for share in (one for one in study.shares if one.tested and study.name in entries):
            held, of = counted(entries[study.name].shares[share.label])
            rows.append(f"| {study.name} | {share.label} | {held} of {of} | {_claim(share)} |")
    return "\n".join(rows) + "\n"


def _claim(share: Share) -> str:
    low, high = f"{100 * share.at_least:g}", f"{100 * share.at_most:g}"
    if share.at_most == 1.0:
        return f"at least {low}"
    return f"{low} to {high}" if share.at_least else f"at most {high}"


def _said(seeds: Sequence[int]) -> str:
    """Return consecutive seeds in words."""
    return str(seeds[0]) if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}"


def _entry(found: Mapping[str, object]) -> Entry:
    first, _, last = str(found["seeds"]).partition(" to ")
    program = Program(str(found["commit"]), bool(found["clean"]), str(found["date"]), str(found["processor"]))
    shares = found["shares"]
    assert isinstance(shares, dict)
    return Entry(
        program, tuple(range(int(first), int(last or first) + 1)), int(str(found["settings"])),
        float(str(found["seconds"])), {label: one["each"] for label, one in shares.items()},
    )  # fmt: skip


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()  # noqa: S603, S607


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    found = (
        re.search(r"^model name\s*:\s*(.+)$", info.read_text(encoding="utf-8"), re.MULTILINE) if info.exists() else None
    )
    name = found[1].strip() if found else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores"
