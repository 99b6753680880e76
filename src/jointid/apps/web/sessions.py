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

from jointid.apps.web.limits import Limits, megabytes
from jointid.common.errors import JointidError

_TOKEN = re.compile(r"[A-Za-z0-9_-]{43}")
_FOLDER = re.compile(r"[0-9a-f]{40}")
_REMOVED = ".removed-"  # begins the name of a folder on its way out
_DAY = 86400.0
ACTIVE = ("queued", "running")
"""States of an identification that has not ended."""

GONE = "Your data was deleted while this was done, and nothing of it is kept; choose the record again."
"""What is said to a request that a deletion overtook."""


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
        """Change how it stands, unless it has been removed."""
        with contextlib.suppress(FileNotFoundError):
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
        """Keep what stands in the form.

        Raises:
            PageError: the visitor has deleted everything meanwhile, and gets no new folder by it.
        """
        with self.there():
            write_json(self.folder / "draft.json", dict(draft))

    @contextlib.contextmanager
    def there(self) -> Iterator[None]:
        """Raise a `PageError` where the folder is deleted in the middle of what is done in it."""
        try:
            yield
        except FileNotFoundError:
            if self.folder.is_dir():
                raise
            raise PageError(GONE) from None

    @property
    def record(self) -> dict[str, Any] | None:
        """The record: `file` in this folder, `name` for the eye, `size` in bytes, `format`; None if there is none."""
        return read_json(self.folder / "record.json")

    @property
    def preview(self) -> dict[str, Any] | None:
        """What is in the record; see `jointid.apps.web.preview`."""
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
        run.folder.parent.mkdir(exist_ok=True, mode=0o700)
        run.folder.mkdir(mode=0o700)
        return run

    def size(self) -> int:
        """Return the bytes of all its files and folders; one that is linked twice counts once, none that just goes."""
        found: dict[tuple[int, int], int] = {}
        with contextlib.suppress(FileNotFoundError):
            for path in self.folder.rglob("*"):
                stat = path.lstat()
                found[stat.st_dev, stat.st_ino] = stat.st_size
        return sum(found.values())

    def touch(self) -> None:
        """Say that the visitor was here."""
        if self.folder.is_dir():
            os.utime(self.folder)

    def forget(self) -> None:
        """Remove all of it; it leads nowhere at once, so that nothing is written into it while it goes."""
        aside = self.folder.with_name(f"{_REMOVED}{secrets.token_hex(8)}")
        try:
            self.folder.rename(aside)
        except FileNotFoundError:
            return
        except OSError:  # Windows keeps the name of a folder in which a file is open
            aside = self.folder
        shutil.rmtree(aside, ignore_errors=True)


@dataclass(frozen=True, slots=True)
class Sessions:
    """The folders of all visitors, in one folder."""

    root: Path
    limits: Limits

    @property
    def cookie(self) -> str:
        """The name of the visitors' cookie, which browsers keep by host alone: each folder has its own."""
        place = str(self.root.resolve()).encode("utf-8", errors="surrogateescape")
        return f"jointid_visitor_{hashlib.sha256(place).hexdigest()[:12]}"

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

    def admit(self, visitor: Visitor, coming: int, *, new: bool) -> None:
        """Let a visitor bring a record: a new one gets a folder, that of one who was here must be there still.

        Args:
            visitor: who brings it.
            coming: bytes that may come, those of others that are on their way included.
            new: whether the visitor was not here before.

        Raises:
            PageError: a further visitor would be too many, the folder is full, or it is gone.
        """
        if not new and not visitor.folder.is_dir():
            raise PageError(GONE)
        if new and sum(1 for _ in self.all()) >= self.limits.visitors:
            raise PageError(
                f"{self.limits.visitors} visitors have data on this page, and no more are taken; ask one of them to "
                'press "Delete my data", or come back later.'
            )
        self.require_room(visitor, coming)
        visitor.folder.mkdir(parents=True, exist_ok=True, mode=0o700)

    def require_room(self, visitor: Visitor, coming: int = 0) -> None:
        """Raise a `PageError` where a visitor's folder is full, or all of them are with what is coming, in bytes."""
        if (size := visitor.size()) > self.limits.kept:
            raise PageError(
                f"Your data takes {megabytes(size)}, and at most {megabytes(self.limits.kept)} are kept; press "
                '"Delete my data" first.'
            )
        if (size := sum(one.size() for one in self.all())) + coming > self.limits.everything:
            raise PageError(
                f"The data of all visitors takes {megabytes(size)}, and at most {megabytes(self.limits.everything)} "
                'are kept, with what is on its way; press "Delete my data" if you are done, or come back later.'
            )

    def expire(self) -> None:
        """Remove the folders of visitors who did not come back, unless something of theirs runs."""
        oldest = time.time() - self.limits.days * _DAY
        for visitor in self.all():
            with contextlib.suppress(FileNotFoundError):  # they may delete it at the same time
                if visitor.folder.stat().st_mtime < oldest and not any(run.active for run in visitor.runs):
                    visitor.forget()

    def recover(self) -> None:
        """Say of each identification that the page was stopped in the middle of that it has ended; end removals."""
        for path in self.root.glob(f"{_REMOVED}*"):
            shutil.rmtree(path, ignore_errors=True)
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
