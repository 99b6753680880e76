"""Who uses the page: a random cookie for each visitor, and a folder that only this cookie leads to.

A folder is called by the hash of its cookie, so that a listing of folders lets nobody in. It holds the record under
a name of ours, the draft of the form, and a folder for each identification.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jointid.common.errors import JointidError
from jointid.web.limits import Limits, megabytes

COOKIE = "jointid_visitor"
_TOKEN = re.compile(r"[A-Za-z0-9_-]{43}")
_FOLDER = re.compile(r"[0-9a-f]{40}")
_DAY = 86400.0
ACTIVE = ("queued", "running")
"""States of an identification that has not ended."""


class PageError(JointidError):
    """A request that the page refuses, in a sentence."""


@dataclass(frozen=True, slots=True)
class Run:
    """One identification: its folder, whose `run.json` says how it stands."""

    folder: Path

    @property
    def number(self) -> int:
        """Its place among those of its visitor, from 1."""
        return int(self.folder.name)

    @property
    def status(self) -> dict[str, Any]:
        """How it stands: state, sentence, and the seconds since the epoch when it was queued, started and ended."""
        return read_json(self.folder / "run.json") or {"state": "gone", "sentence": "It has been removed."}

    @property
    def active(self) -> bool:
        """Whether it has not ended."""
        return self.status["state"] in ACTIVE

    def update(self, **values: object) -> None:
        """Change how it stands."""
        if self.folder.is_dir():
            write_json(self.folder / "run.json", self.status | values)

    def lines(self) -> list[str]:
        """Return what it told of its progress, a complete line each."""
        try:
            text = (self.folder / "progress.txt").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return []
        return text.split("\n")[:-1]

    def has(self, name: str) -> bool:
        """Whether it has left a file of that name."""
        return (self.folder / name).is_file()


@dataclass(frozen=True, slots=True)
class Visitor:
    """One visitor's folder."""

    folder: Path

    @property
    def draft(self) -> dict[str, str]:
        """What stands in the form, by field."""
        return read_json(self.folder / "draft.json") or {}

    def save_draft(self, draft: Mapping[str, str]) -> None:
        """Keep what stands in the form."""
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_json(self.folder / "draft.json", dict(draft))

    @property
    def record(self) -> dict[str, Any] | None:
        """The record: `file` in this folder, `name` for the eye, `size` in bytes, `format`; None if there is none."""
        return read_json(self.folder / "record.json")

    @property
    def preview(self) -> dict[str, Any] | None:
        """What is in the record; see `jointid.web.preview`."""
        return read_json(self.folder / "preview.json")

    @property
    def runs(self) -> list[Run]:
        """Its identifications, the latest first."""
        found = [Run(path) for path in (self.folder / "runs").glob("*") if path.name.isdigit()]
        return sorted(found, key=lambda run: -run.number)

    def run(self, number: int) -> Run | None:
        """Return one identification."""
        run = Run(self.folder / "runs" / str(number))
        return run if run.folder.is_dir() else None

    def new_run(self, limits: Limits) -> Run:
        """Make the folder of a further identification; the oldest that has ended makes room.

        Raises:
            PageError: as many as are kept have not ended.
        """
        runs = self.runs
        for old in [run for run in reversed(runs) if not run.active][: max(len(runs) - limits.runs + 1, 0)]:
            shutil.rmtree(old.folder, ignore_errors=True)
        if len(self.runs) >= limits.runs:
            raise PageError(f"{limits.runs} identifications of yours are waiting or running; cancel one of them first.")
        run = Run(self.folder / "runs" / str(runs[0].number + 1 if runs else 1))
        run.folder.mkdir(parents=True, mode=0o700)
        return run

    def size(self) -> int:
        """Return the bytes of all its files; one that is linked twice counts once."""
        found = {(s.st_dev, s.st_ino): s.st_size for s in (p.stat() for p in self.folder.rglob("*") if p.is_file())}
        return sum(found.values())

    def require_room(self, limits: Limits) -> None:
        """Raise a `PageError` where the folder is full."""
        if self.folder.is_dir() and (size := self.size()) > limits.kept:
            raise PageError(
                f"Your data takes {megabytes(size)}, and at most {megabytes(limits.kept)} are kept; press "
                '"Delete my data" first.'
            )

    def touch(self) -> None:
        """Say that the visitor was here."""
        if self.folder.is_dir():
            os.utime(self.folder)

    def forget(self) -> None:
        """Remove all of it."""
        shutil.rmtree(self.folder, ignore_errors=True)


@dataclass(frozen=True, slots=True)
class Sessions:
    """The folders of all visitors, in one folder."""

    root: Path
    limits: Limits

    def visitor(self, token: str | None) -> Visitor | None:
        """Return the visitor that a cookie belongs to; None for a cookie that is not one of ours."""
        if token is None or not _TOKEN.fullmatch(token):
            return None
        return Visitor(self.root / hashlib.sha256(token.encode("ascii")).hexdigest()[:40])

    def all(self) -> Iterator[Visitor]:
        """Yield every visitor who has a folder."""
        for path in self.root.glob("*"):
            if _FOLDER.fullmatch(path.name) and path.is_dir():
                yield Visitor(path)

    def require_place(self, visitor: Visitor) -> None:
        """Raise a `PageError` where a further visitor would be too many."""
        if not visitor.folder.is_dir() and sum(1 for _ in self.all()) >= self.limits.visitors:
            raise PageError(
                f"{self.limits.visitors} visitors have data on this page, and no more are taken; ask one of them to "
                'press "Delete my data", or come back later.'
            )
        visitor.require_room(self.limits)

    def expire(self) -> None:
        """Remove the folders of visitors who did not come back, unless something of theirs runs."""
        oldest = time.time() - self.limits.days * _DAY
        for visitor in self.all():
            with contextlib.suppress(FileNotFoundError):  # they may delete it at the same time
                if visitor.folder.stat().st_mtime < oldest and not any(run.active for run in visitor.runs):
                    visitor.forget()

    def recover(self) -> None:
        """Say of each identification that the page was stopped in the middle of that it has ended."""
        for visitor in self.all():
            for run in visitor.runs:
                if run.active:
                    sentence = "The page was stopped before this had ended; press Identify again."
                    run.update(state="failed", sentence=sentence, ended=time.time())


def new_token() -> str:
    """Return the cookie of a new visitor: 256 bits that nobody can guess."""
    return secrets.token_urlsafe(32)


def read_json(path: Path) -> dict[str, Any] | None:
    """Return a file of ours, None if it is not there."""
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a file of ours at once: who reads it sees the old one or the new one."""
    beside = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    beside.write_text(json.dumps(value, ensure_ascii=False), encoding="utf-8")
    beside.replace(path)
