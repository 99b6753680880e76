"""The folder in which the page keeps everything: record, entries of the form, a folder of each run; and its bounds."""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jointid.common.errors import JointidError, RecordError
from jointid.common.files import beside, is_full, open_file, write_whole
from jointid.records.formats import format_of

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine reaches."""

_OF_A_RUN = ("answer.txt", "learned.txt", "log.txt", "progress.txt", "test.csv", "test.mat")
"""Names of ours, in a format of records."""

_LONGEST = 255  # bytes of a file's name
_LONGEST_CLEAN = 80  # characters
_OTHER = re.compile(r"[^\w .()+-]")
_UPLOAD = "upload-"

DRAFT, PREVIEW, CHECKED = ".draft.json", ".preview.json", ".checked.json"
"""What follows the name of a record's file in those of what belongs to it."""


class PageError(JointidError):
    """A request that the page refuses, in a sentence."""


FULL = "The disk on which this page keeps its files is full; free space there, and try again."
"""What is said wherever that ends something."""


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
        planning: seconds that the search for the next test takes.
    """

    upload: int = 256 * 2**20
    joint_file: int = 256 * 2**10
    memory: int = 4 * 2**30
    seconds: float = 3600.0
    reading: float = 300.0
    form: float = 20.0
    planning: float = 60.0


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

        The state is "running", "done", "refused", "failed", "cancelled", or "planning" while the next test is planned
        after it; `unplanned` is then the sentence on why there is none, and `before` the state that comes back.
        """
        found = read_json(self.folder / "run.json") or {}
        times = [found.get(key) or 0 for key in ("started", "ended")]
        if isinstance(found.get("state"), str) and all(
            isinstance(one, int | float) and 0 <= one < 1e10 for one in times
        ):
            return found
        return {
            "state": "gone",
            "sentence": "How it ended is not known: its folder was removed or damaged, or the disk is full.",
        }

    @property
    def active(self) -> bool:
        """Whether it is running or a test is being planned."""
        return self.status["state"] in ("running", "planning")

    @property
    def work(self) -> dict[str, Any]:
        """The names of the files it identifies: `file`, the first record, and `files`, all.

        Raises:
            PageError: `work.json` is damaged, or names what is no file of its folder.
        """
        work = read_json(self.folder / "work.json") or {}
        files = work.get("files")
        if not isinstance(files, list) or not all(map(self.has, [work.get("file"), *files])):
            raise PageError(
                f"work.json of identification {self.number} is damaged: it names no file of its folder; press Identify "
                "again."
            )
        return work

    def end_planning(self, sentence: str = "") -> None:
        """Go back to how the identification ended; the sentence says why there is no test."""
        self.update(state=self.status.get("before", "done"), unplanned=sentence)

    @property
    def file(self) -> str:
        """The name of its joint file or robot file."""
        return "robot.toml" if self.has("robot.toml") else "joint.toml"

    @property
    def answered(self) -> bool:
        """Whether its answer is there; its report may still be missing."""
        return self.has("answer.json")

    @property
    def stamps(self) -> dict[str, str]:
        """Stamps of the versions of answer and report; empty if missing."""
        return {
            name: _stamp(self.folder / file) for name, file in (("answer", "answer.json"), ("report", "report.html"))
        }

    @property
    def plan_stamp(self) -> str:
        """Stamp of the version of the plan."""
        return _stamp(self.folder / "plan.json")

    @property
    def seconds(self) -> float:
        """How long it has taken: to its answer, its end, or now."""
        status = self.status
        ended = status.get("ended") or time.time()
        if self.answered:
            ended = (self.folder / "answer.json").stat().st_mtime
        return float(max(ended - (status.get("started") or ended), 0.0))

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
        return _is_in(self.folder, name)


@dataclass(frozen=True, slots=True)
class Folder:
    """The folder of the page."""

    path: Path

    @property
    def draft(self) -> dict[str, str]:
        """The entries of the form, by field."""
        return {key: text for key, text in (self._read(DRAFT) or {}).items() if isinstance(text, str)}

    def save_draft(self, draft: Mapping[str, str]) -> None:
        """Keep the entries of the form."""
        write_json(self.path / f"{self._file}{DRAFT}", draft)

    @property
    def record(self) -> dict[str, Any] | None:
        """The record: `file` in this folder, `name` for the eye, `size` in bytes, `format`; None if none is as stated.

        `more` has `file` and `name` of each further file, and `robot` says whether they are of a robot file.
        """
        found = {"more": [], "robot": False, "size": None, "format": "", **(read_json(self.path / "record.json") or {})}
        every = [found, *(found["more"] if isinstance(found["more"], list) else [None])]
        for one in every:
            if not (isinstance(one, dict) and isinstance(one.get("name"), str) and _is_in(self.path, one.get("file"))):
                return None
        return found if isinstance(found["size"], int) else None

    @property
    def sent(self) -> dict[str, str]:
        """The files of the record and of its robot's model: by their names in a run, the first record first."""
        record = self.record
        every = [] if record is None else [record, *record["more"]]
        return {name_in_run(one["name"]): one["file"] for one in every}

    def save_record(
        self,
        fresh: Path,
        name: str,
        draft: Mapping[str, str],
        more: Sequence[tuple[Path, str]] = (),
        *,
        robot: bool = False,
    ) -> None:
        """Put a file of this folder in the record's place, with the name it came with and its entries of the form.

        Beside it come further files of this folder, of one robot or one joint.

        All that belongs to a record is called by its file, so that `record.json`, written last, is the one switch: on a
        disk that is full the record before stays, with all that belongs to it.
        """
        old = ["", *self.sent.values()]
        size, kind = fresh.stat().st_size, format_of(fresh).name
        stated = {"file": fresh.name, "name": name, "size": size, "format": kind, "robot": robot}
        others = [{"file": path.name, "name": called} for path, called in more]
        write_json(self.path / f"{fresh.name}{DRAFT}", draft)
        write_json(self.path / "record.json", {**stated, "more": others})
        for file in old:
            self.discard(file)

    def discard(self, file: str) -> None:
        """Remove a rejected upload and its companions; keep the current record and what belongs to it."""
        if file not in (self._file, *self.sent.values()):
            for of_it in (DRAFT, PREVIEW, CHECKED, *([""] if file else [])):
                (self.path / f"{file}{of_it}").unlink(missing_ok=True)

    @property
    def preview(self) -> dict[str, Any] | None:
        """The columns of the record, see `jointid.apps.web.preview`; None if it could not be read yet."""
        return self._read(PREVIEW)

    @property
    def checked(self) -> dict[str, Any] | None:
        """Summary of the record from the check of its channels; None if unchecked."""
        return self._read(CHECKED)

    def drop_preview(self) -> None:
        """Remove the preview of a record that cannot be read as the form says."""
        (self.path / f"{self._file}{PREVIEW}").unlink(missing_ok=True)

    @property
    def _file(self) -> str:
        """The name of the record's file here; empty where there is none, whose entries are kept as well."""
        return str((self.record or {}).get("file", ""))

    def _read(self, of_it: str) -> dict[str, Any] | None:
        return read_json(self.path / f"{self._file}{of_it}")

    @property
    def runs(self) -> list[Run]:
        """All identifications, the latest first."""
        paths = [path for path in (self.path / "runs").glob("*") if re.fullmatch("[0-9]{1,9}", path.name)]
        return sorted((Run(path) for path in paths if _is_own(path)), key=lambda run: -run.number)

    def run(self, number: int) -> Run | None:
        """Return an identification by its number; None if unknown."""
        run = Run(self.path / "runs" / str(number))
        return run if _is_own(run.folder) and run.folder.is_dir() else None

    def new_run(self, files: Mapping[str, str], made: Mapping[str, Any]) -> Run:
        """Make the folder of an identification that begins; its records have the names in it that its file says.

        Args:
            files: those of this folder, by their names in the run; the first is the record.
            made: `name` and `text` of the joint file or robot file, `records` that it names, and whether to `learn`.

        Raises:
            RecordError: it cannot be written; there is nothing of it then.
            PageError: a symbolic link is in its place.
        """
        runs = self.runs
        run = Run(self.path / "runs" / str(runs[0].number + 1 if runs else 1))
        refuse_link(run.folder.parent, run.folder)
        run.folder.parent.mkdir(exist_ok=True)
        with beside(run.folder) as fresh:
            fresh.mkdir()
            link_files(self.path, files, fresh)
            write_whole(fresh / made["name"], made["text"])
            work = {"file": made["records"][0], "records": made["records"], "learn": made["learn"], "files": [*files]}
            write_json(fresh / "work.json", work)
            write_json(fresh / "run.json", {"state": "running", "sentence": "", "started": time.time()})
        return run

    def new_upload(self, suffix: str) -> Path:
        """Return the path for a file that comes in; no word of a sentence is like its name."""
        return self.path / f"{_UPLOAD}{secrets.token_hex(6)}{suffix}"

    def finish_interrupted_runs(self) -> None:
        """Mark an interrupted run as ended, and remove partial uploads."""
        kept = tuple(self.sent.values())
        for path in self.path.glob(f"{_UPLOAD}*"):
            if not path.name.startswith(kept):
                path.unlink(missing_ok=True)
        for run in self.runs:
            if run.status["state"] == "planning":
                run.end_planning("The page was stopped before a test was planned.")
            elif run.active:
                sentence = "The page was stopped before this had ended; press Identify again."
                run.update(state="failed", sentence=sentence, ended=time.time())


def _is_in(folder: Path, name: object) -> bool:
    """Whether something is the name of a file in a folder, and no link or path to another one."""
    if not isinstance(name, str) or "\0" in name or Path(name).name != name:
        return False
    return (folder / name).is_file() and not (folder / name).is_symlink()


def _is_own(folder: Path) -> bool:
    """Whether a run's folder is no link to another one, nor the folder of all runs."""
    return not (folder.is_symlink() or folder.parent.is_symlink())


def refuse_link(*paths: Path) -> None:
    """Refuse symbolic links, through which files elsewhere would be overwritten.

    Raises:
        PageError: one of the paths is a link.
    """
    for path in paths:
        if path.is_symlink():
            raise PageError(f"{path} is a symbolic link, which may lead out of the page's folder; remove it.")


def link_files(folder: Path, files: Mapping[str, str], into: Path) -> None:
    """Put files of a folder into another one under other names; without a copy where the disk can."""
    for name, file in files.items():
        try:
            os.link(folder / file, into / name)
        except OSError:
            shutil.copyfile(folder / file, into / name)


def clean_name(raw: str) -> str:
    """Return the last part of a path without any character that has a meaning; fit to be shown and for an archive."""
    name = _OTHER.sub("_", re.split(r"[/\\]", raw)[-1])
    return name[-_LONGEST_CLEAN:].strip(" .") or "record"


def name_in_run(name: str) -> str:
    """Return the name of a record in a run's folder: the one it came with, unless ours has it, or it is too long."""
    unfit = name.lower() in _OF_A_RUN or name.lower().endswith(".json") or len(name.encode()) > _LONGEST
    return f"record{Path(name).suffix}" if unfit else name


def _stamp(path: Path) -> str:
    try:
        return str(path.stat().st_mtime_ns)
    except OSError:
        return ""


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
