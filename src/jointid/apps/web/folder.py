"""The folder in which the page keeps everything: the files of `now/`, and those of each identification in `runs/N/`."""

from __future__ import annotations

import contextlib
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

from jointid.common.errors import JointidError, RecordError
from jointid.common.files import beside, is_full, open_file, write_whole

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine reaches."""
MODELS = (".urdf", ".xml", ".mjcf")
"""Suffixes of a robot's model."""
FULL = "The disk on which this page keeps its files is full; free space there, and try again."
REFUSED = 2  # exit code of a process whose refusal is in fault.json

_OURS = ("answer.txt", "learned.txt", "log.txt", "progress.txt")  # in a format of records
_THEIRS = "record-"
_LONGEST = 80  # characters of a file's name
_OTHER = re.compile(r"[^\w .()+-]")


class PageError(JointidError):
    """A request that the page refuses, in a sentence."""


def refusal_of(error: JointidError | OSError) -> JointidError:
    """Return the sentence of the page on an error.

    Raises:
        OSError: it is not for the person to mend.
    """
    if is_full(error):
        return PageError(FULL)
    if isinstance(error, OSError):
        raise error
    return error


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of one page.

    Attributes:
        upload: bytes of a record.
        joint_file: bytes of a joint file.
        memory: bytes of memory of each process that reads or identifies, beside its libraries; see
            `jointid.common.bounds`. What the compiled simulation reserves is in it.
        seconds: after which an identification is stopped.
        reading: seconds after which the reading of a record is stopped.
        form: seconds after which that of a joint file, or of a form, is.
    """

    upload: int = 256 * 2**20
    joint_file: int = 256 * 2**10
    memory: int = 4 * 2**30
    seconds: float = 3600.0
    reading: float = 300.0
    form: float = 20.0


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
        """State, sentence, and when it started and ended, in seconds since the epoch.

        The state is "running", "done", "refused", "failed" or "cancelled"; "gone" where that is not known.
        """
        found = read_json(self.folder / "run.json") or {}
        times = [found.get(key, 0) for key in ("started", "ended")]
        if isinstance(found.get("state"), str) and all(
            isinstance(one, int | float) and 0 <= one < 1e10 for one in times
        ):
            return {"sentence": "", "started": 0, **found}
        sentence = "How it ended is not known: its folder was removed or damaged, or the disk is full."
        return {"state": "gone", "sentence": sentence, "started": 0}

    @property
    def active(self) -> bool:
        """Whether it is running."""
        return bool(self.status["state"] == "running")

    @property
    def file(self) -> str:
        """The name of its joint file or robot file."""
        return "robot.toml" if self.has("robot.toml") else "joint.toml"

    @property
    def seconds(self) -> float:
        """How long it has taken: to its end, or now."""
        status = self.status
        return float(max(status.get("ended", time.time()) - status["started"], 0.0))

    def update(self, **values: object) -> None:
        """Change its status; it has none from then on where it cannot be kept."""
        try:
            write_json(self.folder / "run.json", self.status | values)
        except RecordError:  # the folder has been removed, or the disk is full, and "running" would never end
            with contextlib.suppress(OSError):
                (self.folder / "run.json").unlink(missing_ok=True)

    def read_progress(self) -> list[str]:
        """Return the complete lines of progress printed so far."""
        return self.read_text("progress.txt").replace("\r\n", "\n").split("\n")[:-1]

    def read_text(self, name: str) -> str:
        """Return a text of its folder; empty if it has none."""
        try:
            return (self.folder / name).read_bytes().decode("utf-8", "replace") if self.has(name) else ""
        except OSError:
            return ""

    def has(self, name: object) -> bool:
        """Return whether its folder has a file."""
        return is_in(self.folder, name)


@dataclass(frozen=True, slots=True)
class Folder:
    """The folder of the page."""

    path: Path

    @property
    def now(self) -> Path:
        """The folder of the record and of what the forms say."""
        return self.path / "now"

    @property
    def draft(self) -> dict[str, str]:
        """The entries of the forms, by field."""
        found = read_json(self.now / "draft.json") or {}
        return {key: text for key, text in found.items() if isinstance(text, str)}

    def save_draft(self, draft: Mapping[str, str]) -> None:
        """Keep the entries of the forms."""
        self.now.mkdir(exist_ok=True)
        write_json(self.now / "draft.json", draft)

    @property
    def sent(self) -> list[str]:
        """The names of the files that were sent, records first; empty where one is missing."""
        sent = (read_json(self.now / "sent.json") or {}).get("files")
        return sent if isinstance(sent, list) and all(is_in(self.now, one) for one in sent) else []

    @property
    def robot(self) -> bool:
        """Whether the files are of a robot."""
        return any(name.lower().endswith(MODELS) for name in self.sent)

    @property
    def preview(self) -> dict[str, Any] | None:
        """The columns of the first record, see `jointid.apps.web.preview`; None if it could not be read."""
        return read_json(self.now / "columns.json")

    @property
    def checked(self) -> dict[str, Any] | None:
        """Summary of the record from the check of its channels; None if unchecked."""
        return read_json(self.now / "checked.json")

    @contextlib.contextmanager
    def receiving(self) -> Iterator[Path]:
        """Yield a folder for files that come in; it goes at the end, unless `replace` took it."""
        fresh = self.path / f"upload-{secrets.token_hex(6)}"
        fresh.mkdir()
        try:
            yield fresh
        finally:
            shutil.rmtree(fresh, ignore_errors=True)

    def replace(self, fresh: Path, sent: list[str], draft: Mapping[str, str]) -> None:
        """Put a folder with files that were sent in the place of the record before."""
        write_json(fresh / "sent.json", {"files": sent})
        write_json(fresh / "draft.json", draft)
        with self.receiving() as old:
            if self.now.exists():
                self.now.rename(old / "now")
            fresh.rename(self.now)

    @property
    def runs(self) -> list[Run]:
        """All identifications, the latest first."""
        paths = [path for path in (self.path / "runs").glob("*") if re.fullmatch("[0-9]{1,9}", path.name)]
        return sorted((Run(path) for path in paths if not path.is_symlink()), key=lambda run: -run.number)

    def run(self, number: int) -> Run | None:
        """Return an identification by its number; None if unknown."""
        run = Run(self.path / "runs" / str(number))
        return run if run.folder.is_dir() and not (run.folder.is_symlink() or run.folder.parent.is_symlink()) else None

    def new_run(self) -> Run:
        """Make the folder of an identification that begins, with the files it takes.

        Raises:
            RecordError: it cannot be written; there is nothing of it then.
            PageError: a symbolic link is in its place.
        """
        runs = self.runs
        run = Run(self.path / "runs" / str(runs[0].number + 1 if runs else 1))
        refuse_links(self.path)
        run.folder.parent.mkdir(exist_ok=True)
        file = "robot.toml" if self.robot else "joint.toml"
        with beside(run.folder) as fresh:
            fresh.mkdir()
            for name in (*self.sent, file):
                link(self.now / name, fresh / name)
            write_json(fresh / "work.json", {"files": self.sent, "learn": self.draft.get("controller.law") == "learn"})
            write_json(fresh / "run.json", {"state": "running", "sentence": "", "started": time.time()})
        return run

    def finish_interrupted(self) -> None:
        """Mark an interrupted run as ended, put back a record that was being replaced, and remove partial uploads."""
        for path in self.path.glob("upload-*"):
            if (path / "now").is_dir() and not self.now.exists():
                (path / "now").rename(self.now)
            shutil.rmtree(path, ignore_errors=True)
        for run in self.runs:
            if run.active:
                sentence = "The page was stopped before this had ended; press Identify again."
                run.update(state="failed", sentence=sentence, ended=time.time())


def is_in(folder: Path, name: object) -> bool:
    """Return whether something is the name of a file in a folder, and no link or path to another one."""
    if not isinstance(name, str) or "\0" in name or Path(name).name != name:
        return False
    return (folder / name).is_file() and not (folder / name).is_symlink()


def refuse_links(folder: Path) -> None:
    """Refuse symbolic links in a folder, through which files elsewhere would be overwritten.

    Raises:
        PageError: there is one.
    """
    for path in folder.iterdir():
        if path.is_symlink():
            raise PageError(f"{path} is a symbolic link, which may lead out of the page's folder; remove it.")


def link(file: Path, into: Path) -> None:
    """Put a file at another place; without a copy where the disk can."""
    try:
        os.link(file, into)
    except OSError:
        shutil.copyfile(file, into)


def clean_name(raw: str) -> str:
    """Return the last part of a path without any character that has a meaning, and unlike names of ours."""
    name = _OTHER.sub("_", re.split(r"[/\\]", raw)[-1])[-_LONGEST:].strip(" .") or "record"
    if name.lower() in _OURS or (name.lower().endswith(".json") and not name.startswith(_THEIRS)):
        return f"{_THEIRS}{name[len(_THEIRS) - _LONGEST :]}"
    return name


def read_json(path: Path) -> dict[str, Any] | None:
    """Return a file of ours, None if it is not there, damaged or a link to another one."""
    if path.is_symlink():
        return None
    try:
        with open_file(path) as file:
            found = json.load(file)
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a file of ours at once: who reads it sees the old one or the new one. A link there is replaced.

    Raises:
        RecordError: it cannot be written.
    """
    if path.is_symlink():
        path.unlink()
    write_whole(path, json.dumps(value, ensure_ascii=False))
