"""The folder in which the page keeps everything: the files of `now/`, and those of each identification in `runs/N/`.

A joint file or robot file there is the draft. Names that begin with `_` are the page's own; no upload has such a name.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from jointid.apps.web.form import list_records
from jointid.common.errors import JointFileError, JointidError
from jointid.common.files import beside, write_whole
from jointid.config.toml import parse_toml, read_text

MODELS = (".urdf", ".xml", ".mjcf")
"""Suffixes of a robot's model."""

_NUMBER = re.compile("[0-9]{1,9}")
_FILES = ("robot.toml", "joint.toml")


class PageError(JointidError):
    """A request that the page refuses, in a sentence."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of one page.

    Attributes:
        upload: bytes of one upload.
        memory: bytes of memory of each process that reads or identifies, beside its libraries. What the compiled
            simulation reserves is in it.
        seconds: after which an identification is stopped.
        reading: seconds after which the reading of a record is stopped.
    """

    upload: int = 256 * 2**20
    memory: int = 4 * 2**30
    seconds: float = 3600.0
    reading: float = 300.0


@dataclass(frozen=True, slots=True)
class Draft:
    """A folder of records with the joint file or robot file that names them: that of the forms, or of a run."""

    path: Path

    @property
    def name(self) -> str:
        """Name of the folder; of a run its number."""
        return self.path.name

    @property
    def file(self) -> str:
        """The name of its joint file or robot file."""
        return next((name for name in _FILES if self.has(name)), _FILES[-1])

    @property
    def robot(self) -> bool:
        """Whether it is of a robot."""
        return self.file == _FILES[0]

    @property
    def text(self) -> str:
        """The text of its file; empty where it cannot be read."""
        try:
            return read_text(self.path / self.file)
        except JointFileError:
            return ""

    @property
    def tables(self) -> dict[str, Any]:
        """The tables of its file; none where it is damaged."""
        try:
            return parse_toml(self.text)
        except JointFileError:
            return {}

    @property
    def records(self) -> list[str]:
        """Names of the records in the folder, those in its file first."""
        there = [name for name in self.files() if not name.lower().endswith((".toml", *MODELS))]
        return list(dict.fromkeys([*(name for name in list_records(self.tables) if name in there), *there]))

    def has(self, name: str) -> bool:
        """Return whether it has a file of its own by this name."""
        path = self.path / name
        return path.is_file() and not path.is_symlink()

    def files(self) -> list[str]:
        """Return the names of the files that are not the page's own."""
        return sorted(one.name for one in self.path.glob("*") if not one.name.startswith("_") and self.has(one.name))

    def write(self, text: str, name: str = "joint.toml") -> None:
        """Write its file."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_whole(self.path / name, text)

    def read(self, name: str) -> str:
        """Return the text of one of the page's own files; empty without it."""
        try:
            return (self.path / name).read_bytes().decode("utf-8", "replace") if self.has(name) else ""
        except OSError:
            return ""

    def json(self, name: str) -> dict[str, Any]:
        """Return a file as JSON; empty if it is missing or damaged."""
        try:
            found = json.loads(self.read(name))
        except (ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    def write_json(self, name: str, value: Mapping[str, Any]) -> None:
        """Write one of the page's own files."""
        write_whole(self.path / name, json.dumps(value, allow_nan=False))


@dataclass(frozen=True, slots=True)
class Folder:
    """The folder of the page."""

    path: Path

    @property
    def now(self) -> Draft:
        """The records and what the forms say."""
        return Draft(self.path / "now")

    @property
    def runs(self) -> list[Draft]:
        """All identifications, the latest first."""
        paths = [path for path in (self.path / "runs").glob("*") if _NUMBER.fullmatch(path.name) and path.is_dir()]
        return [Draft(path) for path in sorted(paths, key=lambda path: -int(path.name))]

    def run(self, number: str) -> Draft | None:
        """Return an identification by its number; None if unknown."""
        return next((run for run in self.runs if run.name == number), None)

    @contextlib.contextmanager
    def receiving(self) -> Iterator[Draft]:
        """Yield a folder for files that come in; it goes at the end, unless `replace` took it."""
        with TemporaryDirectory(prefix="upload-", dir=self.path, ignore_cleanup_errors=True) as fresh:
            yield Draft(Path(fresh))

    def replace(self, fresh: Draft) -> None:
        """Put a folder with files that were sent in the place of those before."""
        with self.receiving() as old:
            if self.now.path.exists():
                self.now.path.rename(old.path / "now")
            fresh.path.rename(self.now.path)

    def new_run(self, text: str) -> Draft:
        """Make the folder of an identification with its files, the joint file or robot file of this text among them."""
        before = self.runs
        run = Draft(self.path / "runs" / str(int(before[0].name) + 1 if before else 1))
        run.path.parent.mkdir(exist_ok=True)
        with beside(run.path) as fresh:
            fresh.mkdir()
            for name in self.now.files():
                try:
                    os.link(self.now.path / name, fresh / name)
                except OSError:  # the disk has no links
                    shutil.copyfile(self.now.path / name, fresh / name)
            Draft(fresh).write(text, self.now.file)
        return run

    def remove_uploads(self) -> None:
        """Remove what was on its way in when the page was killed."""
        for path in self.path.glob("upload-*"):
            shutil.rmtree(path, ignore_errors=True)
