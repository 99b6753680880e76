"""The campaign file (TOML): joints and records, or simulated runs."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from jointid import DIDIM
from jointid.campaigns.campaign_tables import CampaignTable, MultistartTable
from jointid.campaigns.cases import Case, Redrawn, Simulated, Started
from jointid.campaigns.fleet import FleetRecords, Logged, named_record
from jointid.common.errors import JointFileError
from jointid.common.text import join as in_a_row
from jointid.config import JointFile, loads
from jointid.config.loading import parse_toml, read_text
from jointid.config.table import faults_of


@dataclass(frozen=True)
class Campaign:
    """A campaign file; the files it names are listed on demand.

    Attributes:
        folder: from which its paths are taken.
    """

    name: str
    table: CampaignTable
    folder: Path

    def cases(self) -> Iterator[Case]:
        """Yield the cases in a reproducible order."""
        for changes in self._combinations:
            if self.table.fleet is not None:
                for one in self._fleet.found:
                    yield Case(
                        one.joint, one.joint_file, one.address, one.stamp, one.day, changes, settings=one.settings
                    )
            elif self.table.monte_carlo is not None:
                runs = self.table.monte_carlo
                text, motion, values = self._run_once
                for number in range(runs.runs):
                    simulated = Simulated(values, runs.noise_force, runs.noise_log, runs.seed + number)
                    yield Case(motion.joint, text, motion.address, motion.stamp, "", changes, simulated)
            elif self.table.bootstrap is not None:
                asked = self.table.bootstrap
                logged = self._named_record(asked.joint, asked.record)
                if not isinstance(loads(logged.joint_file), JointFile):
                    raise JointFileError(
                        f"[bootstrap] draws the error of a joint's record; {asked.joint} is a robot file: use [fleet] "
                        "or [monte_carlo]."
                    )
                for number in range(asked.runs):
                    drawn = Redrawn(asked.seed + number)
                    yield Case(logged.joint, logged.joint_file, logged.address, logged.stamp, "", changes, drawn)
            elif self.table.multistart is not None:
                yield from self._of_starts(changes, self.table.multistart)

    @property
    def left_out(self) -> str:
        """Describe skipped files of a fleet; empty if none."""
        return "" if self.table.fleet is None else self._fleet.left_out

    @cached_property
    def _combinations(self) -> tuple[tuple[str, ...], ...]:
        keys = [
            dict.fromkeys(f"{key}={json.dumps(value)}" for value in values) for key, values in self.table.sweep.items()
        ]
        return tuple(itertools.product(*keys))

    @cached_property
    def _fleet(self) -> FleetRecords:
        assert self.table.fleet is not None
        return FleetRecords(self.table.fleet, self.folder)

    @cached_property
    def _run_once(self) -> tuple[str, Logged, tuple[tuple[str, float], ...]]:
        """Joint file, reference record and truth of simulated runs."""
        asked = self.table.monte_carlo
        assert asked is not None
        text = read_text(self.folder / asked.joint)
        file = loads(text, (self.folder / asked.joint).parent)
        if not isinstance(file, JointFile):
            logged = self._named_record(asked.joint, asked.record)
            return logged.joint_file, logged, tuple((name, float(value)) for name, value in asked.values.items())
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

    def _of_starts(self, changes: tuple[str, ...], asked: MultistartTable) -> Iterator[Case]:
        logged = self._named_record(asked.joint, asked.record)
        text = logged.joint_file
        file = loads(text, changes=changes)
        if not isinstance(file, JointFile):
            raise JointFileError(f"[multistart] draws starts of a joint file; {asked.joint} is a robot file, whose "
                                 "search begins by itself: use [fleet] or [monte_carlo].")  # fmt: skip
        given = {name: p.start for name, p in file.parameters.items() if p.free and p.start}
        if not given:
            raise JointFileError(
                f"[multistart] draws starts around those of the joint file, and {asked.joint} gives no free parameter "
                "one other than 0; give some, as parameters.stiffness.start."
            )
        if isinstance(file.method, DIDIM):  # which has starts of its own
            changes = (*changes, 'method.start="given"')
        for number in range(asked.runs):
            draw = np.random.default_rng([asked.seed + number])
            starts = tuple((name, start * asked.spread ** draw.uniform(-1.0, 1.0)) for name, start in given.items())
            started = Started(starts, asked.seed + number)
            yield Case(logged.joint, text, logged.address, logged.stamp, "", changes, started)

    def _named_record(self, joint: str, record: str | None) -> Logged:
        return named_record(self.folder / joint, None if record is None else self.folder / record)


def load_campaign(path: Path) -> Campaign:
    """Load and validate a campaign file, without the records."""
    path = Path(os.path.abspath(path))  # noqa: PTH100 - without the .. that another spelling of it has
    raw = parse_toml(read_text(path))
    corrected, faults = CampaignTable.correct_keys(raw)
    try:
        table = CampaignTable.model_validate(corrected)
    except ValidationError as error:
        raise JointFileError([*faults, *faults_of(error)]) from None
    if faults:
        raise JointFileError(faults)
    campaign = Campaign(table.name or path.stem, table, path.parent)
    first = next(campaign.cases())
    own = {one.partition("=")[0] for one in first.settings}
    if both := [key for key in campaign.table.sweep if key in own]:
        raise JointFileError(f"{in_a_row(both)} is set by [sweep] and by the fleet's table; leave one of them out.")
    for changes in campaign._combinations:
        loads(first.joint_file, changes=(*first.settings, *changes))
    return campaign
