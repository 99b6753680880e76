"""The campaign file (TOML): joints and their records."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pydantic import ValidationError

from jointid.campaigns.campaign_tables import CampaignTable
from jointid.campaigns.cases import Case
from jointid.campaigns.fleet import FleetRecords
from jointid.common.errors import JointFileError
from jointid.common.text import join as in_a_row
from jointid.config import loads
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
            for one in self._fleet.found:
                yield Case(one.joint, one.joint_file, one.address, one.stamp, one.day, changes, settings=one.settings)

    @property
    def left_out(self) -> str:
        """Describe skipped files of the fleet; empty if none."""
        return self._fleet.left_out

    @cached_property
    def _combinations(self) -> tuple[tuple[str, ...], ...]:
        keys = [
            dict.fromkeys(f"{key}={json.dumps(value)}" for value in values) for key, values in self.table.sweep.items()
        ]
        return tuple(itertools.product(*keys))

    @cached_property
    def _fleet(self) -> FleetRecords:
        return FleetRecords(self.table.fleet, self.folder)


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
