"""A document as one HTML page, the pictures of a report, and the data to repeat it.

A page opens without a network, prints, and runs no script. Its policy allows none: a text that got past the escaping
would still be nothing but text. The answer it carries for other programs is JSON in which no tag can end.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from jointid import __version__
from jointid.common.document import Document, Heading, templates
from jointid.common.files import digest, explain, write_folder
from jointid.output.json import REPORT_ELEMENT

PAGES = (".html", ".htm")
_FEW = 4  # headings: a shorter page needs no list of contents


def page(document: Document) -> str:
    """Return a document as one HTML page; the same document gives the same bytes."""
    anchors: dict[int, str] = {}  # of the headings, each name once
    for place, block in enumerate(document.blocks):
        if isinstance(block, Heading) and block.level == 2:
            name = re.sub(r"[^a-z0-9]+", "-", block.text.lower()).strip("-") or "part"
            anchors[place] = name if name not in anchors.values() else f"{name}-{place}"
    contents = [(getattr(document.blocks[place], "text", ""), name) for place, name in anchors.items()]
    return templates(Path(__file__).parent).get_template("page.html").render(
        title=document.title,
        blocks=[(block, anchors.get(place, "")) for place, block in enumerate(document.blocks)],
        contents=contents if len(contents) >= _FEW else [],
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


@dataclass(frozen=True, slots=True)
class Repetition:
    """Version, files and command that reproduce a report; empty where they are unknown.

    Attributes:
        version: of this program.
        record_file: name of the record's file, or files.
        record_date: year-month-day when the file was last written (UTC).
        record_file_sha256: of that file, or of these one after the other.
        joint_file_name, joint_file: name and text of the file of the joint or of the robot.
        command: that writes the report again.
    """

    version: str = __version__
    record_file: str = ""
    record_date: str = ""
    record_file_sha256: str = ""
    joint_file_name: str = ""
    joint_file: str = ""
    command: str = ""


def repetition(
    joint: Path,
    records: Sequence[Path],
    options: Mapping[str, object],
    changes: Iterable[str] = (),
    html: str = "report.html",
) -> Repetition:
    """Return the data to repeat a report; files by their names, without their folders.

    Of the command's options None leaves one away; `changes` are keys of the joint file, as ``method.frequency=30``.
    The files are those of one record; where there are several, the joint file names them, and not the command.

    Raises:
        RecordError: a file cannot be read.
    """
    words = ["jointid", "report", joint.name, *(["--record", records[0].name] if len(records) == 1 else [])]
    given = {name.replace("_", "-"): str(value) for name, value in options.items() if value is not None}
    pairs = [*given.items(), *(("set", change) for change in changes), ("html", html)]
    command = shlex.join([*words, *(word for name, value in pairs for word in (f"--{name}", value))])
    with explain(joint, "opened", "check the path"):
        text = joint.read_text(encoding="utf-8")
    known = digest(*records)
    date = datetime.fromtimestamp(records[0].stat().st_mtime, UTC).date().isoformat()
    names = ", ".join(record.name for record in records)
    return Repetition(__version__, names, date, known, joint.name, text, command)
