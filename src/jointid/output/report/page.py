"""A document as one HTML page, the pictures of a report, and the data to repeat it.

A page opens without a network, prints, and runs no script. Its policy allows none: a text that got past the escaping
would still be nothing but text. The answer it carries for other programs is JSON in which no tag can end.
"""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from jointid import __version__
from jointid.common.document import Block, Code, Document, Heading, templates
from jointid.common.errors import RecordError
from jointid.common.files import digest, write_folder
from jointid.output.json import REPORT_ELEMENT

_FEW = 4  # headings: a shorter page needs no list of contents
_CREATED = re.compile(rb"Created on: \w{3} (\w{3} +\d+ \d\d:\d\d:\d\d \d{4})")  # of the header of a .mat file


def page(document: Document) -> str:
    """Return a document as one HTML page; the same document gives the same bytes."""
    headings = [block for block in document.blocks if isinstance(block, Heading) and block.level == 2]
    anchors = _anchors(block.text for block in headings)
    links = dict(zip(map(id, headings), anchors, strict=True))
    return templates(Path(__file__).parent).get_template("page.html").render(
        title=document.title,
        blocks=[(block, links.get(id(block), "")) for block in document.blocks],
        contents=list(zip((block.text for block in headings), anchors, strict=True)) if len(headings) >= _FEW else [],
        style=Path(__file__).with_name("style.css").read_text(encoding="utf-8"),
        answer=document.answer,
        element=REPORT_ELEMENT,
    )  # fmt: skip


def save(document: Document, folder: str | Path, name: str) -> tuple[Path, ...]:
    """Write `name`.html and the pictures into a folder, which is made; return what was written.

    Raises:
        RecordError: the folder or a file cannot be written.
    """
    return write_folder(folder, {f"{name}.html": page(document).encode()} | document.pictures)


def _anchors(texts: Iterable[str]) -> list[str]:
    """Return names for headings to be linked by, each once."""
    found: list[str] = []
    for text in texts:
        name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "part"
        while name in found:
            name += "-"
        found.append(name)
    return found


@dataclass(frozen=True, slots=True)
class Repetition:
    """Version, files and command that reproduce a report.

    Attributes:
        version: of this program.
        record_name: file, or files, of the record; empty for one that came from no file, as the next ones.
        record_sha256: of that file, or of these one after the other.
        date: of the record, as year-month-day: that in a .mat file's header, else when the file was last written (UTC).
        joint_name: file of the joint or of the robot.
        joint_file: its text.
        command: that writes the report again.
        system: "joint" or "robot".
    """

    version: str = __version__
    record_name: str = ""
    record_sha256: str = ""
    date: str = ""
    joint_name: str = ""
    joint_file: str = ""
    command: str = ""
    system: Literal["joint", "robot"] = "joint"

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """The names and hashes that are known."""
        names = ("jointid", "Record", "Its date", "Its SHA-256")
        found = zip(names, (self.version, self.record_name, self.date, self.record_sha256), strict=True)
        return tuple((name, value) for name, value in found if value)

    @property
    def blocks(self) -> list[Block]:
        """The command and the file of the joint or of the robot."""
        found = [
            (self.command, f"The command, with {self.system} file and record beside each other:"),
            (self.joint_file, f"The {self.system} file, {self.joint_name}:"),
        ]
        return [Code(text, caption) for text, caption in found if text]

    @property
    def document(self) -> dict[str, str | None]:
        """Its part of the report's JSON; null where it is unknown."""
        found = {
            "record_file": self.record_name,
            "record_date": self.date,
            "record_file_sha256": self.record_sha256,
            f"{self.system}_file_name": self.joint_name,
            f"{self.system}_file": self.joint_file,
            "command": self.command,
        }
        return {"version": self.version} | {key: text or None for key, text in found.items()}


def repetition(
    joint: Path,
    records: Sequence[Path],
    options: Mapping[str, object],
    changes: Iterable[str] = (),
    html: str = "report.html",
    system: Literal["joint", "robot"] = "joint",
) -> Repetition:
    """Return the data to repeat a report; files by their names, without their folders.

    Of the command's options None leaves one away; `changes` are keys of the joint file, as ``method.frequency=30``.
    The files are those of one record; where there are several, the joint file names them, and not the command.

    Raises:
        RecordError: a file cannot be read.
    """
    words = ["jointid", "report", joint.name, *(["--record", records[0].name] if len(records) == 1 else [])]
    for name, value in options.items():
        if value is not None:
            words += [f"--{name.replace('_', '-')}", str(value)]
    for change in changes:
        words += ["--set", change]
    try:
        text, date = joint.read_text(encoding="utf-8"), _find_date(records[0])
    except OSError as error:
        why = (error.strerror or type(error).__name__).lower()
        raise RecordError(f"{error.filename} cannot be opened ({why}); check the path.") from None
    return Repetition(
        record_name=", ".join(record.name for record in records),
        record_sha256=digest(*records),
        date=date,
        joint_name=joint.name,
        joint_file=text,
        command=shlex.join([*words, "--html", html]),
        system=system,
    )


def _find_date(record: Path) -> str:
    """Return the date of a record's file; a copy that keeps no times still has that of its header, where it has one."""
    with contextlib.suppress(IsADirectoryError, ValueError), record.open("rb") as file:
        if created := _CREATED.search(file.read(128)):
            return datetime.strptime(created[1].decode("ascii"), "%b %d %H:%M:%S %Y").date().isoformat()
    return datetime.fromtimestamp(record.stat().st_mtime, UTC).date().isoformat()


def require_page(path: Path) -> None:
    """Raise a `RecordError` if a page cannot be saved under that name."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise RecordError(f'A report is saved as .html; received "{path.name}": change its suffix.')
