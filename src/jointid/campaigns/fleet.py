"""A fleet: records by joint, from one pattern or a table."""

from __future__ import annotations

import datetime
import hashlib
import os
import posixpath
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import tomli_w

from jointid.campaigns.addresses import is_remote, list_addresses, stamp_of
from jointid.campaigns.campaign_tables import PLACEHOLDER, PLACEHOLDERS, FleetTable, unknown_placeholders
from jointid.campaigns.fleet_table import FleetRow, RowFaults, read_fleet_table
from jointid.common.errors import JointFileError, RecordError
from jointid.common.text import join as in_a_row
from jointid.common.text import pluralise
from jointid.config import loads
from jointid.config.loading import parse_toml, read_text

_NAMED = 5  # files or joints that a sentence names


@dataclass(frozen=True, slots=True)
class Logged:
    """A record of a joint.

    Attributes:
        address, stamp, day: of the record, as a case has them.
        settings: keys of the joint file that are set for this joint alone.
    """

    joint: str
    joint_file: str
    address: str
    stamp: str
    day: str
    settings: tuple[str, ...] = ()


@dataclass(frozen=True)
class FleetRecords:
    """The records of a fleet, listed on demand.

    Attributes:
        asked: the table [fleet] of the campaign file.
    """

    asked: FleetTable
    folder: Path
    _texts: dict[Path, str] = field(default_factory=dict, repr=False, compare=False)
    _matched: dict[tuple[str, Path], dict[str, list[tuple[str, str, str]]]] = field(
        default_factory=dict, repr=False, compare=False
    )
    _undated: list[str] = field(default_factory=list, repr=False, compare=False)

    @cached_property
    def found(self) -> tuple[Logged, ...]:
        """The records, in a reproducible order."""
        return tuple(self._of_pattern() if self.asked.table is None else self._of_table(self.folder / self.asked.table))

    @property
    def left_out(self) -> str:
        """Describe files without a date and joints without a record; empty if none."""
        said, without = [], list[str]()
        if self.asked.table is not None:
            with_one = {one.joint for one in self.found}
            without = [name for name in dict.fromkeys(row.name for row in self._table[0]) if name not in with_one]
        if self._undated:
            said.append(
                f"{len(self._undated)} files have no date as 2026-11-23 or 20261123 where [fleet] says {{day}}, "
                f"and are left out: {_some(self._undated)}."
            )
        if without:
            said.append(f"{pluralise(len(without), 'joint')} of the table have no record yet: {_some(without)}.")
        return " ".join(said)

    @cached_property
    def _table(self) -> tuple[tuple[FleetRow, ...], RowFaults]:
        assert self.asked.table is not None
        return read_fleet_table(self.folder / self.asked.table)

    def _of_pattern(self) -> list[Logged]:
        pattern = self.asked.records
        assert self.asked.joint is not None
        if pattern is None and "{joint}" in self.asked.joint:
            raise JointFileError(
                f'fleet.joint is "{self.asked.joint}", and there is no fleet.records to say which joints there are; '
                "add it."
            )
        if pattern is None:
            return [named_record(self.folder / self.asked.joint, None)]
        matched, texts, faults = self._match(pattern, self.folder), dict[str, str](), list[str]()
        for joint in matched:
            try:
                texts[joint] = self._text(self.folder, self.asked.joint, joint)
            except JointFileError as error:
                faults += error.faults
        if faults:
            raise JointFileError(faults)
        return [Logged(joint, texts[joint], *one) for joint, records in matched.items() for one in records]

    def _of_table(self, path: Path) -> list[Logged]:
        (rows, faults), texts = self._table, dict[FleetRow, str]()
        for row in rows:
            try:
                folder, joint = self._joint_of(row, path.parent)
                texts[row] = self._text(folder, joint, row.name)
            except JointFileError as error:
                faults.add(row.number, error.faults)
        for row, said in _check_settings(texts):
            faults.add(row.number, said)
        made, taken = list[Logged](), dict[tuple[str, str], int]()
        for row, text in texts.items():
            try:
                found = [replace(one, joint=row.name) for one in self._of_row(row, text, path.parent)]
            except (JointFileError, RecordError) as error:
                faults.add(row.number, error.faults)
                continue
            for one in found:
                first = taken.setdefault((one.joint, one.address), row.number)
                if first != row.number:
                    faults.add(row.number, [f"{one.address} is a record of {one.joint} in row {first}, too; leave one "
                                            "out, or have settings side by side by [sweep]."])  # fmt: skip
            made += found
        faults.raise_any()
        if not made:
            raise JointFileError(f"{path} names {pluralise(len(rows), 'row')}, and no record is there; correct the "
                                 "paths, which are taken from its folder.")  # fmt: skip
        return made

    def _joint_of(self, row: FleetRow, place: Path) -> tuple[Path, str]:
        """A row's joint file, and the base folder of its path."""
        if row.joint or self.asked.joint is None:
            if not row.joint:
                raise JointFileError("it names no joint file; fill in joint, or add joint to [fleet] for all.")
            return place, row.joint
        return self.folder, self.asked.joint

    def _of_row(self, row: FleetRow, text: str, place: Path) -> list[Logged]:
        if row.record:
            return [Logged(row.name, text, *_single(row.record, place, row.day), row.settings)]
        folder, pattern = (place, row.records) if row.records else (self.folder, self.asked.records)
        if pattern is None:
            where, joint = self._joint_of(row, place)
            return [named_record(where / joint.replace("{joint}", row.name), None, row.settings)]
        if faults := tuple(map("".join, unknown_placeholders("records", pattern, tuple(PLACEHOLDERS)))):
            raise JointFileError(faults)
        matched = self._match(pattern, folder)
        # One listing serves all rows: those of a flat folder would each go through all its files.
        ours = [matched.get(row.name, [])] if "{joint}" in pattern else matched.values()
        return [Logged(row.name, text, *one, row.settings) for records in ours for one in records]

    def _text(self, folder: Path, joint: str, name: str) -> str:
        path = folder / joint.replace("{joint}", name)
        if path not in self._texts:
            self._texts[path] = _embed_model(read_text(path), path.parent)
        return self._texts[path]

    def _match(self, pattern: str, folder: Path) -> Mapping[str, list[tuple[str, str, str]]]:
        """Address, stamp and day of matches, by joint."""
        if (pattern, folder) not in self._matched:
            by_joint = self._matched[pattern, folder] = dict[str, list[tuple[str, str, str]]]()
            plain = pattern if is_remote(pattern) else posixpath.normpath(pattern)
            shape = re.compile(f"(?:^|/){_expression(re.sub(r'^([.][.]/)+|^/', '', plain))}$")
            stars = PLACEHOLDER.sub(lambda one: one[0] if one[1] is None else "*", plain)
            for address, stamp in list_addresses(stars, folder).items():
                said = shape.search(address.replace(os.sep, "/"))
                if said is None:
                    self._undated.append(address)
                    continue
                parts = said.groupdict()
                logged = address, stamp, _day(parts.get("day"), address, stamp)
                by_joint.setdefault(parts.get("joint", "joint"), []).append(logged)
        matched = self._matched[pattern, folder]
        if not matched and self.asked.table is None:
            raise JointFileError(f'fleet.records is "{pattern}", and no file is of that form; correct the path.')
        return matched


def _embed_model(text: str, folder: Path) -> str:
    """Return the text of a file for a case, with absolute path and digest of a robot's model."""
    try:
        tables = parse_toml(text)
    except JointFileError:
        return text  # whose fault loading it says
    if "robot" not in tables:
        return text
    model = tables["robot"].get("model") if isinstance(tables["robot"], dict) else None
    if not isinstance(model, str) or not (folder / model).is_file():
        return text  # likewise
    path = (folder / model).absolute()
    tables["robot"]["model"] = str(path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return f"# the model's SHA-256: {digest}\n{tomli_w.dumps(tables)}"


def named_record(joint: Path, record: Path | None, settings: tuple[str, ...] = ()) -> Logged:
    """Return a record by path, or the one that a joint file names.

    Args:
        joint: path of the joint file.
        record: path of the record; the joint file's when None.
        settings: keys of the joint file that are set, possibly record.file.
    """
    path = joint.absolute()
    text = _embed_model(read_text(path), path.parent)
    named = loads(text, changes=settings).source.file if record is None else record
    if named is None:
        raise JointFileError(f"{path} names no record; add file to its [record], or name records in this file.")
    place = path.parent / named
    stamp = stamp_of(place)
    return Logged(path.stem, text, str(place.absolute()), stamp, _day(None, str(place), stamp), settings)


def _single(record: str, folder: Path, day: str) -> tuple[str, str, str]:
    """Address, stamp and day of a row's record; no stamp if it is unreadable."""
    if is_remote(record):
        address, stamp = next(iter(list_addresses(record, folder).items()), (record, ""))
    else:
        address = os.path.normpath(folder / record)
        try:
            stamp = stamp_of(Path(address))
        except RecordError:
            stamp = ""
    return address, stamp, day or _day(None, address, stamp)


def _check_settings(texts: Mapping[FleetRow, str]) -> Iterator[tuple[FleetRow, tuple[str, ...]]]:
    """Yield rows with settings that their joint file refuses, and its sentences.

    For rows that differ in numbers, only the extremes are checked unless one fails, since bounds hold in between.
    """
    alike = dict[tuple[str, ...], list[tuple[FleetRow, list[float]]]]()
    for row, text in texts.items():
        kinds, numbers = [], []
        for setting in row.settings:
            key, _, value = setting.partition("=")
            try:
                numbers.append(float(value))
                kinds.append(key)
            except ValueError:
                kinds.append(setting)
        alike.setdefault((text, *kinds), []).append((row, numbers))
    for (text, *_), members in alike.items():
        rows, values = [row for row, _ in members], np.array([one for _, one in members])
        ends = {0, *map(int, values.argmin(axis=0)), *map(int, values.argmax(axis=0))} if values.size else {0}
        if any(_faults(text, rows[k].settings) for k in ends):
            yield from ((row, _faults(text, row.settings)) for row in rows)


@lru_cache(maxsize=1024)
def _faults(text: str, settings: tuple[str, ...]) -> tuple[str, ...]:
    try:
        loads(text, changes=settings)
    except JointFileError as error:
        return error.faults
    return ()


def _some(names: list[str]) -> str:
    return in_a_row([*names[:_NAMED], *(["others"] if len(names) > _NAMED else [])])


def _expression(pattern: str) -> str:
    """Regular expression of a pattern; a repeated placeholder matches the same text."""
    seen: set[str] = set()

    def part(found: re.Match[str]) -> str:
        name = found[1]
        if name is None:
            return "[^/]*" if found[2] else "[^/]"
        if name in seen:
            return f"(?P={name})"
        seen.add(name)
        return f"(?P<{name}>{PLACEHOLDERS[name]})"

    parts, at = [], 0
    for found in PLACEHOLDER.finditer(pattern):
        parts += [re.escape(pattern[at : found.start()]), part(found)]
        at = found.end()
    return "".join([*parts, re.escape(pattern[at:])])


def _day(said: str | None, address: str, stamp: str) -> str:
    """Day as 2026-11-23, from the file's name or last change, if known."""
    if said is not None:
        digits = said.replace("-", "")
        return f"{digits[:4]}-{digits[4:6]}-{digits[6:]}"
    if is_remote(address) or not stamp:
        return ""
    return datetime.datetime.fromtimestamp(int(stamp.rpartition(" ")[2]) / 1000, datetime.UTC).date().isoformat()
