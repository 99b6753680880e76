"""Read the folder of a campaign: results and progress, also while it runs."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from jointid.campaigns.cases import Outcome, Row
from jointid.campaigns.shards import has_shards, read_shards
from jointid.campaigns.store import DATABASE, read_database
from jointid.common.document import Block, Document, Documented, Facts, Listing, Paragraph
from jointid.common.errors import RecordError
from jointid.common.messages import describe_time
from jointid.common.text import number, short

_RECENT = 100  # results that determine the rate
_REASONS = 10  # that are shown
_LONGEST = 300  # characters of one


@dataclass(frozen=True, slots=True)
class Results:
    """The results of a campaign so far.

    Attributes:
        rows: results, in an order that depends on no engine.
        stored: when each was stored, in seconds since 1970, in increasing order.
    """

    name: str
    cases: int
    rows: tuple[Row, ...]
    stored: tuple[float, ...]

    @property
    def left(self) -> int:
        """How many cases have no result yet."""
        return self.cases - len(self.rows)

    def counts(self) -> dict[Outcome, int]:
        """Return how many results ended in each way."""
        counted = Counter(row.outcome for row in self.rows)
        return {outcome: counted[outcome] for outcome in Outcome}


def read_results(folder: Path) -> Results:
    """Read the results of a client or of shards, also while running."""
    if (folder / DATABASE).is_file():
        name, cases, found = read_database(folder)
    elif has_shards(folder):
        name, cases, found = read_shards(folder)
    else:
        raise RecordError(
            f"{folder} is no folder of a campaign; name the one that jointid campaign run or work got by --out."
        )
    rows = tuple(sorted((row for _, row in found), key=lambda row: row.place))
    return Results(name, cases, rows, tuple(sorted(stored for stored, _ in found)))


@dataclass(frozen=True)
class Status(Documented):
    """Progress of a campaign.

    Attributes:
        now: when that is, in seconds since 1970.
    """

    results: Results
    now: float

    @cached_property
    def rate(self) -> float | None:
        """Recent results per second; None before there are two."""
        recent = self.results.stored[-_RECENT:]
        if len(recent) < 2 or recent[-1] <= recent[0]:
            return None
        return (len(recent) - 1) / (recent[-1] - recent[0])

    def to_document(self, *, details: bool = False) -> Document:
        """Progress; with details every reason for refusal."""
        results, counts = self.results, self.results.counts()
        ends = ", ".join(f"{count} {outcome}" for outcome, count in counts.items() if count)
        facts = [("done", f"{len(results.rows)} of {results.cases} cases{f': {ends}' if ends else ''}")]
        if results.left and self.rate is not None:
            facts.append(("rate", f"{number(self.rate, 2)}/s over the last {min(len(results.rows), _RECENT)}"))
            facts.append(("time left", describe_time(results.left / self.rate)))
        if results.stored:
            facts.append(("last result", f"{describe_time(self.now - results.stored[-1])} ago"))
        reasons = [row for row in results.rows if row.outcome is not Outcome.IDENTIFIED]
        shown = reasons if details else reasons[:_REASONS]
        blocks: list[Block] = [Facts(tuple(facts)), Listing(tuple(map(describe_row, shown)))]
        if len(shown) < len(reasons):
            blocks.append(Paragraph(f"And {len(reasons) - len(shown)} more: --details shows them."))
        return Document(f"Campaign {results.name}", tuple(blocks))


def describe_row(row: Row) -> str:
    """Describe a result without an answer."""
    what = " ".join(part for part in (row.joint, row.day, "; ".join(row.changes)) if part)
    return f"{what}, {row.outcome}: {short(row.sentence, _LONGEST)}"


def read_status(folder: Path) -> Status:
    """Read how a campaign is getting on; see `read_results`."""
    return Status(read_results(folder), time.time())
