"""The campaign file (TOML): of which joints and records a campaign is made, or which runs it simulates."""

from __future__ import annotations

import datetime
import itertools
import json
import os
import posixpath
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from jointid import DIDIM
from jointid.campaigns.addresses import is_remote, listed, stamp_of
from jointid.campaigns.campaign_tables import (
    PLACEHOLDER,
    PLACEHOLDERS,
    BootstrapTable,
    CampaignTable,
    MultistartTable,
)
from jointid.campaigns.cases import Case, Redrawn, Simulated, Started
from jointid.common.errors import JointFileError
from jointid.common.text import listed as in_a_row
from jointid.config import loads
from jointid.config.loading import parse_toml, read_text
from jointid.config.table import sentences

_NAMED = 5  # files that a sentence names


@dataclass(frozen=True, slots=True)
class Logged:
    """A record of a fleet: the joint's name, the record's address and stamp, and its day."""

    joint: str
    address: str
    stamp: str
    day: str


@dataclass(frozen=True)
class Campaign:
    """A campaign as its file says it; the files it names are listed when they are first asked for.

    Attributes:
        name: of it.
        table: of the file.
        folder: from which its paths are taken.
    """

    name: str
    table: CampaignTable
    folder: Path

    def cases(self) -> Iterator[Case]:
        """Yield the cases, in an order that depends on the file and the records alone.

        Raises:
            JointFileError: a joint file cannot be read, or there is no record.
        """
        for changes in self._combinations:
            if self.table.fleet is not None:
                yield from self._of_fleet(changes)
            elif self.table.monte_carlo is not None:
                yield from self._of_runs(changes)
            elif self.table.bootstrap is not None:
                yield from self._of_resamples(changes, self.table.bootstrap)
            elif self.table.multistart is not None:
                yield from self._of_starts(changes, self.table.multistart)

    @property
    def left_out(self) -> str:
        """A sentence on files that fit the pattern of the records but for their date; empty if there are none."""
        others = self._listed[1] if self.table.fleet is not None else ()
        if not others:
            return ""
        return (
            f"{len(others)} files have no date as 2026-11-23 or 20261123 where [fleet] says {{day}}, and are left out: "
            f"{in_a_row([*others[:_NAMED], *(['others'] if len(others) > _NAMED else [])])}."
        )

    @cached_property
    def _combinations(self) -> tuple[tuple[str, ...], ...]:
        keys = [
            dict.fromkeys(f"{key}={json.dumps(value)}" for value in values) for key, values in self.table.sweep.items()
        ]
        return tuple(itertools.product(*keys))

    def _of_fleet(self, changes: tuple[str, ...]) -> Iterator[Case]:
        for one in self._listed[0]:
            yield Case(one.joint, self._texts[one.joint], one.address, one.stamp, one.day, changes)

    @cached_property
    def _listed(self) -> tuple[tuple[Logged, ...], tuple[str, ...]]:
        """The records of a fleet, and the paths of those without a date where there should be one."""
        assert self.table.fleet is not None
        pattern = self.table.fleet.records
        if pattern is None:
            return (self._named_record(self.table.fleet.joint, None),), ()
        plain = pattern if is_remote(pattern) else posixpath.normpath(pattern)
        shape = re.compile(f"(?:^|/){_expression(re.sub(r'^([.][.]/)+|^/', '', plain))}$")
        found, others = [], []
        stars = PLACEHOLDER.sub(lambda one: one[0] if one[1] is None else "*", plain)
        for address, stamp in listed(stars, self.folder).items():
            said = shape.search(address.replace(os.sep, "/"))
            if said is None:
                others.append(address)
                continue
            parts = said.groupdict()
            found.append(Logged(parts.get("joint", "joint"), address, stamp, _day(parts.get("day"), address, stamp)))
        if not found:
            raise JointFileError(f'fleet.records is "{pattern}", and no file is of that form; correct the path.')
        return tuple(found), tuple(others)

    @cached_property
    def _texts(self) -> Mapping[str, str]:
        """The joint file of each joint of a fleet."""
        assert self.table.fleet is not None
        pattern, texts, faults = self.table.fleet.joint, dict[str, str](), list[str]()
        for joint in dict.fromkeys(one.joint for one in self._listed[0]):
            try:
                texts[joint] = read_text(self.folder / pattern.replace("{joint}", joint))
            except JointFileError as error:
                faults += error.faults
        if faults:
            raise JointFileError(faults)
        return texts

    def _of_runs(self, changes: tuple[str, ...]) -> Iterator[Case]:
        asked = self.table.monte_carlo
        assert asked is not None
        text, motion, values = self._run_once
        for number in range(asked.runs):
            simulated = Simulated(values, asked.noise_force, asked.noise_log, asked.seed + number)
            yield Case(motion.joint, text, motion.address, motion.stamp, "", changes, simulated)

    @cached_property
    def _run_once(self) -> tuple[str, Logged, tuple[tuple[str, float], ...]]:
        """The joint file of simulated runs, the record that they follow, and the truth."""
        asked = self.table.monte_carlo
        assert asked is not None
        text = read_text(self.folder / asked.joint)
        file = loads(text)
        known = {p.name: file.parameters.get(p.name, p).start for p in file.joint.parameters} | asked.values
        unknown = [name for name in asked.values if name not in {p.name for p in file.joint.parameters}]
        missing = [name for name, value in known.items() if value is None]
        if unknown or missing:
            faults = [f"monte_carlo.values.{name} is no parameter of this joint; leave it out." for name in unknown]
            if missing:
                faults.append(
                    f"A simulated run needs a value of every parameter; {in_a_row(missing)} "
                    f"{'have' if len(missing) > 1 else 'has'} none: give them in [monte_carlo.values]."
                )
            raise JointFileError(faults)
        truth = tuple((name, float(value)) for name, value in known.items() if value is not None)
        return text, self._named_record(asked.joint, asked.record), truth

    def _of_resamples(self, changes: tuple[str, ...], asked: BootstrapTable) -> Iterator[Case]:
        text, logged = read_text(self.folder / asked.joint), self._named_record(asked.joint, asked.record)
        for number in range(asked.runs):
            drawn = Redrawn(asked.seed + number)
            yield Case(logged.joint, text, logged.address, logged.stamp, "", changes, drawn)

    def _of_starts(self, changes: tuple[str, ...], asked: MultistartTable) -> Iterator[Case]:
        text, logged = read_text(self.folder / asked.joint), self._named_record(asked.joint, asked.record)
        given = {name: p.start for name, p in loads(text, changes=changes).parameters.items() if p.free and p.start}
        if not given:
            raise JointFileError(
                f"[multistart] draws starts around those of the joint file, and {asked.joint} gives no free parameter "
                "one other than 0; give some, as parameters.stiffness.start."
            )
        if isinstance(loads(text, changes=changes).method, DIDIM):  # which has starts of its own
            changes = (*changes, 'method.start="given"')
        for number in range(asked.runs):
            draw = np.random.default_rng([asked.seed + number])
            starts = tuple((name, start * asked.spread ** draw.uniform(-1.0, 1.0)) for name, start in given.items())
            begun = Started(starts, asked.seed + number)
            yield Case(logged.joint, text, logged.address, logged.stamp, "", changes, begun)

    def _named_record(self, joint: str, record: str | None) -> Logged:
        """Return a record by its path, or the one that a joint file names."""
        path = (self.folder / joint).absolute()
        if "{joint}" in joint:
            raise JointFileError(
                f'fleet.joint is "{joint}", and there is no fleet.records to say which joints there are; add it.'
            )
        named = loads(read_text(path)).source.file if record is None else record
        if named is None:
            raise JointFileError(f"{path} names no record; add file to its [record], or name records in this file.")
        place = (path.parent if record is None else self.folder) / named
        stamp = stamp_of(place)
        return Logged(path.stem, str(place.absolute()), stamp, _day(None, str(place), stamp))


def load_campaign(path: Path) -> Campaign:
    """Load a campaign file, checked completely but for the records it names.

    Args:
        path: of the TOML file, in UTF-8.

    Raises:
        JointFileError: the file cannot be read, is no TOML, or has faults; `faults` has a sentence for each.
    """
    path = Path(os.path.abspath(path))  # noqa: PTH100 - without the .. that another spelling of it has
    raw = parse_toml(read_text(path))
    corrected, faults = CampaignTable.corrected(raw)
    try:
        table = CampaignTable.model_validate(corrected)
    except ValidationError as error:
        raise JointFileError([*faults, *sentences(error)]) from None
    if faults:
        raise JointFileError(faults)
    campaign = Campaign(table.name or path.stem, table, path.parent)
    _check_changes(campaign)
    return campaign


def _check_changes(campaign: Campaign) -> None:
    """Refuse what no joint file can be changed to, as the first case shows it, before thousands of rows say so.

    Raises:
        JointFileError: a change cannot be made, or the joint file has faults.
    """
    first = next(campaign.cases())
    for changes in campaign._combinations:
        loads(first.joint_file, changes=changes)


def _expression(pattern: str) -> str:
    """Return the regular expression of a pattern: each placeholder is a part of a path, and the same wherever it is."""
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
    """Return a day as 2026-11-23: the one in a file's name, else that of its last change, where that is known."""
    if said is not None:
        digits = said.replace("-", "")
        return f"{digits[:4]}-{digits[4:6]}-{digits[6:]}"
    if is_remote(address) or not stamp:
        return ""
    return datetime.datetime.fromtimestamp(int(stamp.rpartition(" ")[2]) / 1000, datetime.UTC).date().isoformat()
