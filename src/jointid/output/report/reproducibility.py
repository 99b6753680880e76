"""The data that reproduces a report: version, files with their hashes, the joint file, and the command."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from jointid import __version__
from jointid.common.errors import RecordError

_BLOCK = 1 << 20  # bytes that are read at once


@dataclass(frozen=True, slots=True)
class Repetition:
    """Version, files and command that reproduce a report.

    Attributes:
        version: of this program.
        record_name: file of the record; empty for one that came from no file, as the next ones.
        record_sha256: of that file.
        joint_name: file of the joint.
        joint_file: its text.
        command: that writes the report again.
    """

    version: str = __version__
    record_name: str = ""
    record_sha256: str = ""
    joint_name: str = ""
    joint_file: str = ""
    command: str = ""

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """The names and hashes that are known."""
        found = [("jointid", self.version), ("Record", self.record_name), ("Its SHA-256", self.record_sha256)]
        return tuple((name, value) for name, value in found if value)


def repetition(
    joint: Path,
    record: Path,
    options: Mapping[str, object],
    changes: Iterable[str] = (),
    html: str = "report.html",
) -> Repetition:
    """Return what it takes to repeat a report.

    Files are told by their names, not by where they lie on this machine.

    Args:
        joint: the joint file.
        record: the record's file.
        options: of the command, by name; None leaves one away.
        changes: keys of the joint file that were set, each as ``method.frequency=30``.
        html: name of the page.

    Raises:
        RecordError: a file cannot be read.
    """
    words = ["jointid", "report", joint.name, "--record", record.name]
    for name, value in options.items():
        if value is not None:
            words += [f"--{name.replace('_', '-')}", str(value)]
    for change in changes:
        words += ["--set", change]
    try:
        text = joint.read_text(encoding="utf-8")
        digest = hashlib.sha256()
        with record.open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
    except OSError as error:
        why = (error.strerror or type(error).__name__).lower()
        raise RecordError(f"{error.filename} cannot be opened ({why}); check the path.") from None
    return Repetition(
        record_name=record.name,
        record_sha256=digest.hexdigest(),
        joint_name=joint.name,
        joint_file=text,
        command=shlex.join([*words, "--html", html]),
    )
