"""From TOML to a joint file and back."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import tomli_w

from jointid.common.errors import JointFileError
from jointid.common.transmission import Transmission
from jointid.config.changes import apply_changes
from jointid.config.contents import JointFile
from jointid.config.serialise import controller_table
from jointid.models.controllers import Controller
from jointid.models.parameters import TORQUE_UNIT

_PLACE = re.compile(r"(?P<reason>.*) \(at (line (?P<line>\d+), column (?P<column>\d+)|end of document)\)", re.DOTALL)

_LARGEST = 2**20  # bytes; a state space of order 100 takes a quarter of it
_DEEPEST = 256  # points in a key: the parser takes the square of their number

_OF_RECORD = re.compile(r"\s*(\[\s*record\s*\]|\[\[\s*records\s*\]\])")
_FILE = re.compile(r"""^(\s*file\s*=\s*)("(?:[^"\\\n]|\\.)*"|'[^'\n]*')""", re.MULTILINE)
_HEADING = r"\s*\[{{1,2}}\s*({0}|\"{0}\"|'{0}')\s*[.\]]"


def load(path: str | os.PathLike[str], changes: Iterable[str] = ()) -> JointFile:
    """Load a joint file, checked completely.

    Args:
        path: of the TOML file, in UTF-8.
        changes: keys to set before it is checked, each as ``method.frequency=30``.

    Raises:
        JointFileError: the file cannot be read, is no TOML, or has faults; `faults` has a sentence for each.
    """
    path = Path(path)
    if "\0" in str(path):
        raise JointFileError(f"{path} is no path: it holds a zero byte; correct it.")
    try:
        if (size := path.stat().st_size) > _LARGEST:
            raise JointFileError(f"{path} has {size} bytes (a joint file has at most {_LARGEST}); is it the record?")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise JointFileError(f"{path} cannot be opened ({_reason(error)}); check the path.") from error
    except UnicodeDecodeError as error:
        raise JointFileError(f"{path} is not text in UTF-8 (byte {error.start}); save it as UTF-8.") from error
    return JointFile.of(apply_changes(_parse(text), changes), path)


def loads(text: str, folder: str | os.PathLike[str] = ".", changes: Iterable[str] = ()) -> JointFile:
    """Load a joint file from its text; see `load`.

    Args:
        text: TOML.
        folder: from which the path of the record is taken.
        changes: keys to set before it is checked, each as ``method.frequency=30``.
    """
    return JointFile.of(apply_changes(_parse(text), changes), Path(folder) / "joint.toml")


def dumps(file: JointFile) -> str:
    """Return a joint file as TOML; `loads` gives it back.

    Raises:
        JointFileError: a joint file cannot say this, or would be refused; `faults` has a sentence for each reason.
    """
    tables = file.tables()
    read_back = JointFile.of(tables)
    if read_back.joint.torque_unit != file.joint.torque_unit:
        joints, channels = (joint.torque_unit or TORQUE_UNIT[joint.kind] for joint in (file.joint, read_back.joint))
        raise JointFileError(
            f"The joint's torque is in {joints}, but its channel's in {channels}; give both in one unit."
        )
    return tomli_w.dumps(tables)


def save(file: JointFile, path: str | os.PathLike[str]) -> None:
    """Write a joint file as TOML in UTF-8; a file that is there is replaced.

    Raises:
        JointFileError: the file cannot be written, or see `dumps`.
    """
    text = dumps(file)
    try:
        Path(path).write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise JointFileError(f"{path} cannot be written ({_reason(error)}); check the folder.") from error


def controller_text(controller: Controller, transmission: Transmission | None = None) -> str:
    """Return the table [controller] of a joint file as TOML.

    Args:
        controller: any of the laws there are.
        transmission: between the joint and the controller, if there is one.

    Raises:
        JointFileError: a joint file has no word for the controller.
    """
    return tomli_w.dumps({"controller": controller_table(controller, transmission)})


def with_controller(text: str, controller: Controller, transmission: Transmission | None = None) -> str:
    """Return the text of a joint file with its [controller] replaced, or added at its end; all else stays as it is.

    Where the controller is written without a heading of its own, as ``controller = { ... }``, the whole file is written
    anew and its comments are lost.

    Args:
        text: TOML; it need not be a joint file that is complete.
        controller: what takes the place of the one there.
        transmission: between the joint and the controller, if there is one.

    Raises:
        JointFileError: the text is no TOML, or a joint file has no word for the controller.
    """
    return _with_table(text, "controller", controller_text(controller, transmission))


def with_parameters(text: str, written: str) -> str:
    """Return the text of a joint file with its [parameters] replaced, or added at its end; see `with_controller`.

    Args:
        text: TOML; it need not be a joint file that is complete.
        written: the table as TOML, its heading and its comments included.

    Raises:
        JointFileError: the text is no TOML.
    """
    return _with_table(text, "parameters", written)


def _with_table(text: str, name: str, written: str) -> str:
    """Return a TOML text with one of its tables replaced by a text that has that table alone."""
    tables = _parse(text)
    made = _join(_sections(text), written, re.compile(_HEADING.format(name)))
    expected = tables | tomllib.loads(written)
    try:
        return made if tomllib.loads(made) == expected else tomli_w.dumps(expected)
    except tomllib.TOMLDecodeError:  # two of them: the old one has no heading
        return tomli_w.dumps(expected)


def with_paths(text: str, before: Path, after: Path) -> str:
    """Return the text of a joint file as it says the same in another folder; all but the records' paths stays as it is.

    Where a path does not stand on a line of its own below its heading, the whole file is written anew and its comments
    are lost.

    Args:
        text: TOML; it need not be a joint file that is complete.
        before: the folder in which it stands.
        after: the folder in which it will stand.

    Raises:
        JointFileError: the text is no TOML.
    """
    expected = _parse(text)
    if before.resolve() == after.resolve():
        return text
    listed = expected.get("records")
    tables = [expected.get("record"), *(listed if isinstance(listed, list) else [])]
    named = [table for table in tables if isinstance(table, dict) and isinstance(table.get("file"), str)]
    for table in named:
        table["file"] = _from_there(table["file"], before, after)

    def moved(line: re.Match[str]) -> str:
        file = _from_there(tomllib.loads(f"file = {line[2]}")["file"], before, after)
        return line[1] + json.dumps(file, ensure_ascii=False)

    sections = _sections(text)
    made = "".join(_FILE.sub(moved, one, count=1) if _OF_RECORD.match(one) else one for one in sections)
    try:
        return made if tomllib.loads(made) == expected else tomli_w.dumps(expected)
    except tomllib.TOMLDecodeError:  # the path is a text of several lines
        return tomli_w.dumps(expected)


def _from_there(file: str, before: Path, after: Path) -> str:
    """Return the path of a file, relative to one folder, as it is from another; an absolute one as it is."""
    if Path(file).is_absolute():
        return file
    try:
        return Path(os.path.relpath((before / file).resolve(), after.resolve())).as_posix()
    except ValueError:  # on another drive nothing is relative
        return str((before / file).resolve())


def _sections(text: str) -> list[str]:
    """Return a TOML text cut before each heading; what begins with a bracket inside a list is none."""
    lines, sections, begin = text.splitlines(keepends=True), [], 0
    for at, line in enumerate(lines):
        if line.lstrip().startswith("[") and _is_whole("".join(lines[begin:at])):
            sections.append("".join(lines[begin:at]))
            begin = at
    return [*sections, "".join(lines[begin:])]


def _is_whole(text: str) -> bool:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


def _join(sections: list[str], written: str, heading: re.Pattern[str]) -> str:
    """Return the sections with those under a heading replaced, in the first one's place, or at the end."""
    kept: list[str] = []
    place = None
    for section in sections:
        if heading.match(section):
            place = len(kept) if place is None else place
        else:
            kept.append(section)
    if place is None:
        return "".join(kept).rstrip("\n") + "\n\n" * bool("".join(kept).strip()) + written
    after = "".join(kept[place:])
    return "".join(kept[:place]) + written + ("\n" if after else "") + after


def _parse(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text."""
    if any(line.count(".") > _DEEPEST and "," not in line for line in text.splitlines()):
        raise JointFileError("The joint file nests lists or tables too deeply; no key of it needs that.")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise JointFileError(_syntax_fault(text, str(error))) from error
    except RecursionError:
        raise JointFileError("The joint file nests lists or tables too deeply; no key of it needs that.") from None
    except ValueError as error:  # a number of more digits than Python reads
        raise JointFileError("The joint file holds a number of thousands of digits; correct it.") from error


def _syntax_fault(text: str, message: str) -> str:
    match = _PLACE.fullmatch(message)
    reason = match["reason"] if match else message
    lines = text.splitlines() or [""]
    line = int(match["line"]) if match and match["line"] else len(lines)
    column = int(match["column"]) if match and match["column"] else len(lines[-1]) + 1
    return (
        f"Line {line}, column {column} is not TOML ({reason[:1].lower()}{reason[1:]}); expected [tables] and lines of "
        'key = value, text in "quotes": correct that line.'
    )


def _reason(error: OSError) -> str:
    return (error.strerror or type(error).__name__).lower()
