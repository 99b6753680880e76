"""From TOML to a joint file and back, and changes to single keys as `--set method.frequency=30` has them."""

from __future__ import annotations

import copy
import json
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from jointid.common import messages
from jointid.common.errors import JointFileError, MethodError, RecordError
from jointid.common.files import open_file, write_whole
from jointid.common.parameters import POSITION_UNIT
from jointid.common.settings import settings_of
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.config.consistency import choose_method
from jointid.config.contents import File, JointFile
from jointid.config.drive_gains import keys_of_controller, table_at
from jointid.config.schema import FileTable, add_gains_of_times
from jointid.config.serialise import controller_table
from jointid.models.controllers import CONTROLLER_UNITS, LAWS, Controller, numbers_of, unit_of_number
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import Joint

if TYPE_CHECKING:
    from jointid.config.robot_file import RobotFile

_PLACE = re.compile(r"(?P<reason>.*) \(at (line (?P<line>\d+), column (?P<column>\d+)|end of document)\)", re.DOTALL)

_LARGEST = 2**20  # bytes; a state space of order 100 takes a quarter of it
_DEEPEST = 256  # points in a key: the parser takes the square of their number

_OF_RECORD = re.compile(r"\s*(\[\s*record\s*\]|\[\[\s*records\s*\]\])")
_TEXT = r"""(?:"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_FILE = re.compile(rf"^(\s*files?\s*=\s*)({_TEXT}|\[(?:{_TEXT}|[\s,])*\])", re.MULTILINE)
_HEADING = r"\s*\[{{1,2}}\s*({0}|\"{0}\"|'{0}')\s*[.\]]"

_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_CONSTANTS = ("true", "false", "inf", "nan")


def load(
    path: str | os.PathLike[str],
    changes: Iterable[str] = (),
    *,
    axis: str | None = None,
    method: str | None = None,
    filtering: str | None = None,
    friction: str | None = None,
) -> JointFile | RobotFile:
    """Load a joint file, or a robot file, which has the table [robot]; it is checked completely.

    Args:
        path: of the TOML file, in UTF-8.
        changes: keys to set before it is checked, each as ``method.frequency=30``.
        axis: the joint of a robot file that is returned as a joint file; see `RobotFile.joint_file`. Changes of
            [method] are then of its own method.
        method: its name, whatever the file and the changes say; another one than the file's comes with its default
            settings.
        filtering: a preset, likewise.
        friction: the name of a law, likewise, of a robot for every joint.

    Raises:
        JointFileError: the file, or the model of a robot that it names, cannot be read, is no TOML, or has faults;
            `faults` has a sentence for each.
        ExtraError: MuJoCo, which reads the model of a robot, is not installed.
    """
    path = Path(path)
    choices = {"method": method, "filtering": filtering, "friction": friction}
    file = _file(parse_toml(read_text(path)), path, changes, axis, **choices)
    if axis is None:
        return file
    if isinstance(file, JointFile):
        raise MethodError(f"{file.path} is a joint file, which has no axis {axis}; leave --axis out.")
    return file.joint_file(axis)


def load_joint(
    path: str | os.PathLike[str],
    changes: Iterable[str] = (),
    *,
    what: str = "This work",
    axis: str | None = None,
    **choices: str | None,
) -> JointFile:
    """Load a joint file, or one joint of a robot file, for work on a single joint.

    Args:
        path: as of `load`.
        changes: as of `load`.
        what: the work, the beginning of the sentence.
        axis: as of `load`.
        choices: `method`, `filtering` and `friction`, as of `load`.

    Raises:
        JointFileError: see `load`.
        MethodError: it is a robot file, and no axis is named.
    """
    path = Path(path)
    if axis is None and "robot" in parse_toml(read_text(path)):  # before the changes and choices of one joint
        raise _robot_error(path, what)
    return require_joint(load(path, changes, axis=axis, **choices), what)


def require_joint(file: File[Any], what: str) -> JointFile:
    """Return a file that is a joint's.

    Args:
        file: as `load` returns it.
        what: the work that is not done with a robot, the beginning of the sentence.

    Raises:
        MethodError: it is a robot file.
    """
    if isinstance(file, JointFile):
        return file
    raise _robot_error(file.path, what)


def _robot_error(path: Path, what: str) -> MethodError:
    return MethodError(f"{what} takes one joint, and {path} is a robot file; name one of its joints by --axis.")


def read_text(path: Path) -> str:
    """Return the text of a joint file, or of another file of the user's in TOML.

    Raises:
        JointFileError: it cannot be read, is too long, or is no text.
    """
    if "\0" in str(path):
        raise JointFileError(f"{path} is no path: it holds a zero byte; correct it.")
    try:
        with open_file(path) as file:
            raw = file.read(_LARGEST + 1)
        if len(raw) > _LARGEST:
            size = max(path.stat().st_size, len(raw))
            raise JointFileError(f"{path} has {size} bytes (a joint file has at most {_LARGEST}); is it the record?")
        return raw.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        reason = (error.strerror or type(error).__name__).lower()
        raise JointFileError(f"{path} cannot be opened ({reason}); check the path.") from error
    except UnicodeDecodeError as error:
        raise JointFileError(f"{path} is not text in UTF-8 (byte {error.start}); save it as UTF-8.") from error


def load_to_learn(path: str | os.PathLike[str], changes: Iterable[str] = (), axis: str | None = None) -> JointFile:
    """Load a joint file whose controller, or gains, may be missing, to learn them.

    The keys of [controller], such as the gain of the drive's chain, are kept; a missing gain of the loop is 1.

    Args:
        path: as of `load`.
        changes: as of `load`.
        axis: as of `load`; the gains of a robot's controllers need to be there.

    Raises:
        JointFileError: see `load`.
    """
    path, changes = Path(path), list(changes)
    if axis is not None:
        return load_joint(path, changes, what="Learning a controller", axis=axis)
    raw = parse_toml(read_text(path))
    tables = apply_changes(raw, changes)
    said = table_at(tables, "controller")
    if "robot" in tables or not isinstance(tables.get("controller", {}), dict):
        return require_joint(_file(raw, path, changes), "Learning a controller")
    law = said.get("law", "cascade")
    kind: Any = LAWS.get(law) if isinstance(law, str) else None  # mypy does not take a type for something with a hash
    required = [one for one in settings_of(kind) if one.required] if kind else []
    known = add_gains_of_times(keys_of_controller(tables))
    stand_ins = [f"controller.{one.name}=1.0" for one in required if one.type is float and one.name not in known]
    law_said = ["controller.law=cascade"] if law == "cascade" else []
    file = JointFile.of(apply_changes(raw, [*law_said, *stand_ins, *changes]), path)
    return replace(file, said=known.intersection(file.said))


def loads(
    text: str,
    folder: str | os.PathLike[str] = ".",
    changes: Iterable[str] = (),
    *,
    method: str | None = None,
    filtering: str | None = None,
    friction: str | None = None,
) -> JointFile | RobotFile:
    """Load a joint file, or a robot file, from its text; see `load`.

    Args:
        text: TOML.
        folder: from which the paths of the record and of a robot's model are taken.
        changes: as of `load`.
        method: as of `load`.
        filtering: as of `load`.
        friction: as of `load`.
    """
    choices = {"method": method, "filtering": filtering, "friction": friction}
    return _file(parse_toml(text), Path(folder) / "joint.toml", changes, **choices)


def _file(
    tables: Mapping[str, Any],
    path: Path,
    changes: Iterable[str] = (),
    axis: str | None = None,
    method: str | None = None,
    filtering: str | None = None,
    friction: str | None = None,
) -> JointFile | RobotFile:
    """Return the file of some tables with changes; see `load`."""
    changes = list(changes)
    number = None if axis is None else _number_of(tables, axis)
    if number is not None:
        (tables, changes), method = _with_method_of_axis(tables, changes, number, method), None
    changed = apply_changes(tables, changes)
    is_robot = "robot" in changed
    # A change may bring the controller by which the file's own method is known, but not that method's name.
    if method is not None and method != _method_name(changed | {"method": tables.get("method", {})}):
        tables = {**tables, "method": {"name": method}}
    if filtering is not None:
        tables = {**tables, "filtering": {"preset": filtering}}
    changed = apply_changes(tables, changes)
    joints = changed.get("joints")
    count = len(joints) if isinstance(joints, list) else 0
    laws: list[tuple[str, ...]] = (
        [("joints", str(k + 1), "friction") for k in range(count)] if is_robot else [("joint", "friction")]
    )
    chosen = [(("method", "name"), method), (("filtering", "preset"), filtering), *((key, friction) for key in laws)]
    for key, choice in chosen:
        if choice is not None:
            _put(changed, list(key), choice)
    if is_robot:
        from jointid.config.robot_file import RobotFile

        return RobotFile.of(changed, path)
    return JointFile.of(changed, path)


def _number_of(tables: Mapping[str, Any], axis: str) -> int | None:
    """Return the number of an axis, from 0; None where the tables have none of that name."""
    joints = tables.get("joints")
    names = [one.get("name") for one in joints if isinstance(one, dict)] if isinstance(joints, list) else []
    return names.index(axis) if "robot" in tables and axis in names else None


def _with_method_of_axis(
    tables: Mapping[str, Any], changes: list[str], number: int, method: str | None
) -> tuple[Mapping[str, Any], list[str]]:
    """Return tables and changes with [method] moved to one axis; another method has its default settings."""
    below, tables = f"joints.{number + 1}.", copy.deepcopy(dict(tables))
    changes = [f"{below}{one}" if re.match(r"method[.=]", one) else one for one in changes]
    if method is None:
        return tables, changes
    own = tables["joints"][number]
    if not isinstance(own.get("method"), dict) or own["method"].get("name") != method:
        own["method"] = {"name": method}
    return tables, [*changes, f'{below}method.name="{method}"']


def _method_name(tables: Mapping[str, Any]) -> str | None:
    """Return the file's method, or the default one."""
    if "robot" in tables:
        from jointid.config.robot_file import read_robot_tables

        return read_robot_tables(tables).method_name
    file, _ = FileTable.read(tables)
    return choose_method(file, file.method.name, file.model or "rigid")


def dumps(file: JointFile | RobotFile) -> str:
    """Return a joint file or a robot file as TOML; `loads` gives it back.

    Without its comments, and with the changes with which it was loaded.
    """
    return tomli_w.dumps(file.tables())


def save_with_controller(
    file: JointFile, controller: Controller, path: Path, record: str | os.PathLike[str] | None = None
) -> None:
    """Write a joint file with its [controller] another one; all else of its text, comments too, stays as it is.

    But for the paths of records: in another folder they lead to the same files from there.

    Args:
        file: the joint file, loaded from a path: its text is taken from there.
        controller: what takes the place of the one there.
        path: to write to; a file that is there is replaced.
        record: the record that the file is to name, instead of the one it names.

    Raises:
        JointFileError: a file cannot be read or written.
    """
    try:
        written = learned_text(file, controller)
        text = with_table(file.path.read_text(encoding="utf-8-sig"), written)
        text = with_paths(text, file.path.parent, path.parent)
        if record is not None and not file.runs:
            text = with_record(text, _relocate_path(os.fspath(record), Path.cwd(), path.parent))
    except OSError as error:
        raise JointFileError(f"{error.filename} cannot be used ({error.strerror}); check the folder.") from error
    _write(path, text)


def _write(path: str | os.PathLike[str], text: str) -> None:
    try:
        write_whole(path, text)
    except RecordError as error:
        raise JointFileError(error.faults) from error


def controller_text(
    controller: Controller,
    transmission: Transmission | None = None,
    torque_per_unit: float | None = None,
    joint: Joint | None = None,
    shown: Iterable[DriveNumber] = (),
) -> str:
    """Return the table [controller] of a joint file as TOML.

    Args:
        controller: any of the laws there are.
        transmission: between the joint and the controller, if there is one.
        torque_per_unit: the torque constant of the joint file, which a gain need not say again.
        joint: whose units stand beside the gains, as comments; without it none do.
        shown: how the drive shows the numbers, which stands there, too.

    Raises:
        JointFileError: a joint file has no word for the controller.
    """
    text = tomli_w.dumps({"controller": controller_table(controller, transmission, torque_per_unit)})
    return text if joint is None else _with_units(text, controller, joint, {one.number: one for one in shown})


def learned_text(file: JointFile, controller: Controller) -> str:
    """Return [controller] as TOML for a joint file whose controller was learned: units, and what the drive shows."""
    shown = file.drive_numbers(controller)
    return controller_text(controller, file.joint.transmission, file.torque_per_unit, file.joint, shown)


def _with_units(text: str, controller: Controller, joint: Joint, shown: Mapping[str, DriveNumber]) -> str:
    """Return the lines of a controller, with units and the drive's numbers as comments."""
    law = numbers_of(controller)

    def name_unit(name: str, value: float) -> str:
        unit = unit_of_number(controller, name, POSITION_UNIT[joint.kind], joint.force_unit)
        there = shown.get(name)
        if there is None or not there.unit:
            return unit
        if there.factor == 1.0 and not (there.inverse or there.per):
            return there.unit
        in_si = "" if CONTROLLER_UNITS in unit else f"{unit}; "
        other = "" if there.name.endswith(name) else f"{there.name} "
        return f"{in_si}{other}{number(there.of(value, law), 4)} {there.unit} in the drive" if value else unit

    units = {f"{name.rpartition('.')[2]} = {value!r}": name_unit(name, value) for name, value in law.items()}
    return "".join(
        f"{line}{f'  # {units[line]}' if units.get(line) else ''}\n" for line in text.rstrip("\n").split("\n")
    )


def with_table(text: str, written: str) -> str:
    """Return the text of a joint file with one table replaced, or added at its end; all else stays as it is.

    Where the table is written without a heading of its own, as ``controller = { ... }``, the whole file is written anew
    and its comments are lost.

    Args:
        text: TOML; it need not be a joint file that is complete.
        written: the table as TOML, its heading and its comments included, see `controller_text`.

    Raises:
        JointFileError: the text is no TOML.
    """
    tables, replaced = parse_toml(text), tomllib.loads(written)
    (name,) = replaced
    return _verify(_join(split_sections(text), written, re.compile(_HEADING.format(name))), tables | replaced)


def with_paths(text: str, before: Path, after: Path) -> str:
    """Return the text of a joint file for another folder, with the records' paths changed.

    Where a path does not stand on a line of its own below its heading, the whole file is written anew and its comments
    are lost.

    Args:
        text: TOML; it need not be a joint file that is complete.
        before: the folder in which it stands.
        after: the folder in which it will stand.

    Raises:
        JointFileError: the text is no TOML.
    """
    expected = parse_toml(text)
    if before.resolve() == after.resolve():
        return text
    listed = expected.get("records")
    tables = [expected.get("record"), *(listed if isinstance(listed, list) else [])]
    for table in (table for table in tables if isinstance(table, dict)):
        table |= {key: _relocate_paths(table[key], before, after) for key in ("file", "files") if key in table}

    def relocate(line: re.Match[str]) -> str:
        named = _relocate_paths(tomllib.loads(f"file = {line[2]}")["file"], before, after)
        return line[1] + json.dumps(named, ensure_ascii=False)

    sections = split_sections(text)
    made = "".join(_FILE.sub(relocate, one, count=1) if _OF_RECORD.match(one) else one for one in sections)
    return _verify(made, expected)


def with_record(text: str, file: str) -> str:
    """Return the text of a joint file that names another record; all else stays as it is.

    Args:
        text: TOML; it need not be a joint file that is complete.
        file: path of the record, from the joint file's folder.

    Raises:
        JointFileError: the text is no TOML.
    """
    expected, line = parse_toml(text), json.dumps(file, ensure_ascii=False)
    other = {key: value for key, value in expected.get("record", {}).items() if key not in ("files", "offsets")}
    expected["record"] = {**other, "file": file}
    sections = split_sections(text)
    for i, one in enumerate(sections):
        if _OF_RECORD.match(one):
            named, count = _FILE.subn(lambda found: found[1].replace("files", "file") + line, one, count=1)
            heading, _, rest = one.partition("\n")
            sections[i] = named if count else f"{heading}\nfile = {line}\n{rest}"
            break
    else:
        sections.append(f"\n[record]\nfile = {line}\n")
    return _verify("".join(sections), expected)


def _verify(made: str, expected: Mapping[str, Any]) -> str:
    """Return a changed text, or the expected tables as text if it does not contain them."""
    try:
        return made if tomllib.loads(made) == expected else tomli_w.dumps(expected)
    except tomllib.TOMLDecodeError:  # two tables of one name, where the old one has no heading; a path of several lines
        return tomli_w.dumps(expected)


def _relocate_paths(named: object, before: Path, after: Path) -> object:
    """Return a path, or a list of them, as seen from another folder; what is neither is unchanged."""
    if isinstance(named, list):
        return [_relocate_paths(one, before, after) for one in named]
    return _relocate_path(named, before, after) if isinstance(named, str) else named


def _relocate_path(file: str, before: Path, after: Path) -> str:
    """Return a relative path as seen from another folder; an absolute one is unchanged."""
    if Path(file).is_absolute():
        return file
    try:
        return Path(os.path.relpath((before / file).resolve(), after.resolve())).as_posix()
    except ValueError:  # on another drive nothing is relative
        return str((before / file).resolve())


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


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text."""
    if deepest_key(text) > _DEEPEST:
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


def apply_changes(tables: Mapping[str, Any], changes: Iterable[str]) -> dict[str, Any]:
    """Return the tables of a joint file with some keys set, not checked yet.

    Args:
        tables: as `tomllib` reads them; they stay as they are.
        changes: each ``key=value``: the dotted key as faults name it, and a value in TOML; a single word needs no
            quotes. Later ones win.

    Raises:
        JointFileError: with a sentence for each change that cannot be read, or whose place is inside another value.
    """
    changed, faults = copy.deepcopy(dict(tables)), list[str]()
    for change in changes:
        try:
            path, value = _parse_change(change)
            _put(changed, path, value)
        except JointFileError as error:
            faults += error.faults
    if faults:
        raise JointFileError(faults)
    return changed


def _parse_change(change: str) -> tuple[list[str], Any]:
    """Return the path of a change's key and its value.

    Raises:
        JointFileError: it is not ``key=value``.
    """
    key, equals, text = change.partition("=")
    quoted = messages.format_value(change)
    if not equals or not key.strip():
        raise JointFileError(f'--set {quoted} is not key=value; write it as "method.frequency=30".')
    try:
        if deepest_key(change) > _DEEPEST:
            raise ValueError
        path = list(_path(tomllib.loads(f"{key} = 0")))
    except (ValueError, RecursionError):
        raise JointFileError(
            f"--set {quoted} names no key; expected one with points, as method.frequency: correct it."
        ) from None
    try:
        text = text.strip()
        word = _WORD.fullmatch(text) is not None and text not in _CONSTANTS
        (value,) = (text,) if word else tomllib.loads(f"value = {text}").values()
    except (tomllib.TOMLDecodeError, RecursionError, ValueError):
        raise JointFileError(
            f"--set {quoted} has no value that TOML knows; expected a number, true, false, a word, "
            'a list as [1, 2], a table as {lower = 1.0} or text in "quotes": correct it.'
        ) from None
    return path, value


def _path(tables: Mapping[str, Any]) -> Iterator[str]:
    """Yield the parts of the one key that tables hold."""
    for key, below in tables.items():
        yield key
        if isinstance(below, dict):
            yield from _path(below)


def _put(tables: dict[str, Any], path: list[str], value: Any) -> None:
    """Set the value at a path, with the tables on the way to it.

    Raises:
        JointFileError: something on the way is no table, or a list is shorter.
    """
    here: Any = tables
    for place, key in enumerate(path):
        last, at = place == len(path) - 1, messages.dot_path(path[:place])
        if isinstance(here, list):
            first = messages.first_place(path[place - 1])
            if not key.isdecimal() or not first <= int(key) < len(here) + first:
                raise JointFileError(
                    f"{at}.{key} is set, but {at} lists {len(here)}, counted from {first}; name one of them."
                )
            index: Any = int(key) - first
        elif isinstance(here, dict):
            index = key
        else:
            found = messages.format_value(here)
            raise JointFileError(
                f"{messages.dot_path(path)} is set, but {at} is {found} and no table; set {at} as a whole."
            )
        if last:
            here[index] = value
        else:
            here = here.setdefault(index, {}) if isinstance(here, dict) else here[index]


# Strings of several lines, strings of one, comments; a missing end is searched for once.
_QUOTED = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5})?'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]|\\[^\n])*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+",
    re.DOTALL,
)
_BETWEEN_KEYS = re.compile(r"[=,\n\[\]{}]")


def _blank(text: str) -> str:
    """Return a text of the same length in which strings are underscores and comments blanks."""
    return _QUOTED.sub(lambda found: (" " if found[0][0] == "#" else "_") * len(found[0]), text)


def deepest_key(text: str) -> int:
    """Return the largest number of dots in a key of a TOML text.

    Example:
        >>> from jointid.config.loading import deepest_key
        >>> deepest_key('[a.b.c]\\nd = [1.5, 2.5]  # e.f.g.h.i\\n')
        2
    """
    return max(part.count(".") for part in _BETWEEN_KEYS.split(_blank(text)))


def split_sections(text: str) -> list[str]:
    """Return a TOML text split before each heading; brackets inside lists do not count.

    Example:
        >>> from jointid.config.loading import split_sections
        >>> split_sections("a = [\\n[1],\\n]\\n[b]\\nc = 1\\n")
        ['a = [\\n[1],\\n]\\n', '[b]\\nc = 1\\n']
    """
    begins, deep, at = [0], 0, 0
    for line in _blank(text).split("\n"):
        if deep == 0 and line.lstrip().startswith("[") and at:
            begins.append(at)
        deep += line.count("[") + line.count("{") - line.count("]") - line.count("}")
        at += len(line) + 1
    return [text[begin:end] for begin, end in zip(begins, [*begins[1:], len(text)], strict=True)]
