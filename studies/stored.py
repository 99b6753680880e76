"""Outcomes of all studies in `docs/studies.json`, and the tables of the documentation that are made of them."""

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

from studies.comparing import counted
from studies.study import Share, Study

ROOT = Path(__file__).resolve().parents[1]
STORED = ROOT / "docs" / "studies.json"
_BETWEEN = re.compile(r"(?P<head><!-- studies: (?P<name>[\w-]+) -->\n).*?(?P<foot><!-- end of studies -->)", re.DOTALL)


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


def make_table(study: Study, entry: Entry | None) -> str:
    """Return the table of a study in Markdown, with where and when it was made; a sentence if it was not run."""
    if entry is None:
        return f"{study.shows} (Not run yet: `python -m studies {study.name}`.)\n"
    rows = ["| | holds in | of | % | stated, % |", "|---|---|---|---|---|"]
    for share in study.shares:
        held, of = counted(entry.shares[share.label])
        rows.append(f"| {share.label} | {held} | {of} | {100 * held / max(of, 1):.1f} | {_claim(share)} |")
    program = entry.program
    tree = "" if program.clean else " with changes"
    made = (
        f"{study.shows} (`python -m studies {study.name}`: seeds {_said(entry.seeds)}; "
        f"commit {program.commit[:9]}{tree}, {program.date}, {program.processor}.)"
    )
    return "\n".join([made, "", *rows, ""])


def fill_tables(text: str, studies: Iterable[Study], entries: Mapping[str, Entry]) -> str:
    """Return a page whose tables between the markers of studies are those of the stored outcomes."""
    by_name = {study.name: study for study in studies}

    def filled(found: re.Match[str]) -> str:
        name = found["name"]
        return f"{found['head']}{make_table(by_name[name], entries.get(name))}{found['foot']}"

    return _BETWEEN.sub(filled, text)


def shown_studies(text: str) -> list[str]:
    """Return the names of the studies whose tables a page has."""
    return [found["name"] for found in _BETWEEN.finditer(text)]


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
