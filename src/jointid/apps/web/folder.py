"""The folder in which the page keeps everything: record, entries of the form, a folder of each run; and its bounds."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jointid.common.errors import JointidError
from jointid.records.formats import format_of

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine reaches."""


_OF_A_RUN = ("answer.txt", "learned.txt", "log.txt", "progress.txt")  # of ours, in a format of records
_LONGEST = 255  # bytes of a file's name


class PageError(JointidError):
    """A request that the page refuses, in a sentence."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of one page.

    Attributes:
        upload: bytes of a record.
        joint_file: bytes of a joint file.
        memory: bytes of address space of each process that reads or identifies, where the system bounds it (not
            Windows, not macOS); what the compiled simulation reserves is in it.
        seconds: after which an identification is stopped.
        reading: seconds after which the reading of a record is stopped.
    """

    upload: int = 256 * 2**20
    joint_file: int = 256 * 2**10
    memory: int = 4 * 2**30
    seconds: float = 3600.0
    reading: float = 300.0


@dataclass(frozen=True, slots=True)
class Run:
    """One identification: its folder, whose `run.json` holds its state."""

    folder: Path

    @property
    def number(self) -> int:
        """Counted from 1."""
        return int(self.folder.name)

    @property
    def status(self) -> dict[str, Any]:
        """State ("running", "done", "refused", "failed", "cancelled"), sentence, and when it started and ended.

        The times are seconds since the epoch.
        """
        return read_json(self.folder / "run.json") or {"state": "gone", "sentence": "It has been removed."}

    @property
    def active(self) -> bool:
        """Whether it has not ended."""
        return bool(self.status["state"] == "running")

    def update(self, **values: object) -> None:
        """Change its status, unless its folder has been removed."""
        with contextlib.suppress(FileNotFoundError):
            write_json(self.folder / "run.json", self.status | values)

    def read_progress(self) -> list[str]:
        """Return the complete lines of progress printed so far."""
        try:
            text = (self.folder / "progress.txt").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return []
        return text.split("\n")[:-1]

    def has(self, name: str) -> bool:
        """Whether its folder holds a file of that name."""
        return (self.folder / name).is_file()


@dataclass(frozen=True, slots=True)
class Folder:
    """The folder of the page."""

    path: Path

    @property
    def draft(self) -> dict[str, str]:
        """The entries of the form, by field."""
        return read_json(self.path / "draft.json") or {}

    def save_draft(self, draft: Mapping[str, str]) -> None:
        """Keep the entries of the form."""
        write_json(self.path / "draft.json", draft)

    @property
    def record(self) -> dict[str, Any] | None:
        """The record: `file` in this folder, `name` for the eye, `size` in bytes, `format`; None if there is none."""
        return read_json(self.path / "record.json")

    def save_record(self, fresh: Path, name: str, draft: Mapping[str, str]) -> None:
        """Put a file in the record's place.

        Args:
            fresh: the file, in this folder.
            name: under which it came.
            draft: entries of the form that go with it.
        """
        old = self.record
        if old is not None:
            (self.path / old["file"]).unlink(missing_ok=True)
        path = fresh.replace(fresh.with_name(f"record{fresh.suffix}"))
        (self.path / "checked.json").unlink(missing_ok=True)
        size, kind = path.stat().st_size, format_of(path).name
        write_json(self.path / "record.json", {"file": path.name, "name": name, "size": size, "format": kind})
        self.save_draft(draft)

    @property
    def preview(self) -> dict[str, Any] | None:
        """The columns of the record, see `jointid.apps.web.preview`; None if it could not be read yet."""
        return read_json(self.path / "preview.json")

    def drop_preview(self) -> None:
        """Remove the preview of a record that is to be read in another way."""
        (self.path / "preview.json").unlink(missing_ok=True)

    @property
    def runs(self) -> list[Run]:
        """All identifications, the latest first."""
        found = [Run(path) for path in (self.path / "runs").glob("*") if path.name.isdigit()]
        return sorted(found, key=lambda run: -run.number)

    def run(self, number: int) -> Run | None:
        """Return one identification, None if there is none of that number."""
        run = Run(self.path / "runs" / str(number))
        return run if run.folder.is_dir() else None

    def new_run(self, file: str, name: str) -> Run:
        """Make the folder of a further identification, which holds the record under the name that its joint file says.

        Args:
            file: of the record, in this folder.
            name: of the record in the other; see `name_in_run`.
        """
        runs = self.runs
        run = Run(self.path / "runs" / str(runs[0].number + 1 if runs else 1))
        run.folder.mkdir(parents=True)
        try:  # without a copy where the disk can
            os.link(self.path / file, run.folder / name)
        except OSError:
            shutil.copyfile(self.path / file, run.folder / name)
        return run

    def close_interrupted(self) -> None:
        """Mark the run during which an earlier page was killed as ended."""
        for run in self.runs:
            if run.active:
                sentence = "The page was stopped before this had ended; press Identify again."
                run.update(state="failed", sentence=sentence, ended=time.time())


def name_in_run(name: str) -> str:
    """Return the name of a record in a run's folder: the one it came with, unless ours has it, or it is too long."""
    unfit = name.lower() in _OF_A_RUN or len(name.encode()) > _LONGEST
    return f"record{Path(name).suffix}" if unfit else name


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
