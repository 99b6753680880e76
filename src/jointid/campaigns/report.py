"""Report of a campaign: drift of a fleet, distributions by swept settings."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from jointid.campaigns.drift import FALSE_ALARM, Change, Loss, Series, judge, losses_of, name_series, series_of
from jointid.campaigns.run import Outcome, Row
from jointid.common.charts import ERROR, MEASURED, SIMULATED, mark, panels, styled, svg
from jointid.common.document import Block, Document, Documented, Facts, Picture, Table, Text
from jointid.common.text import join, number, pluralise, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN = 10  # rows of a table without details
_LONGEST = 160  # characters of a reason
_PANELS = 24  # of a picture
_TONES: dict[bool | None, Literal["good", "bad", "open"]] = {True: "good", False: "bad", None: "open"}
_CAREFUL, _LAX = 0.7, 1.4  # scatter over stated deviation outside which that is reported


@dataclass(frozen=True)
class CampaignReport(Documented):
    """Report of the results of a campaign.

    Attributes:
        name: of the campaign.
        rows: results, in an order independent of the engine.
        false_alarm: probability that any joint of a fleet without drift is reported.
    """

    name: str
    rows: tuple[Row, ...]
    false_alarm: float = FALSE_ALARM

    @cached_property
    def series(self) -> tuple[Series, ...]:
        """Stiffness and frictions of every joint over its dated runs."""
        return tuple(series_of(self.rows))

    @cached_property
    def losses(self) -> tuple[Loss, ...]:
        """Joints and their quantities without a value in their last runs."""
        return tuple(losses_of(self.rows))

    @cached_property
    def verdict(self) -> tuple[str, bool | None]:
        """Lead sentence and its tone: good, bad, or None if undecided."""
        watched = pluralise(len({one.series.joint for one in self.changes}), "joint")
        good: bool | None = not self.drifted
        if not self.changes:
            said, good = "Drift was not tested: no joint has eight runs.", None
        elif self.drifted:
            said = _count_joints([one.series.joint for one in self.drifted], "drifted")
        else:
            said = f"No stiffness and no friction drifted by more than its scatter ({watched} watched)."
        if not self.losses:
            return said, good
        return f"{_count_joints([one.joint for one in self.losses], 'lost a value')} {said}", False

    @cached_property
    def changes(self) -> tuple[Change, ...]:
        """The best change of every series, sorted by p-value."""
        return judge(self.series, self.false_alarm)

    @property
    def drifted(self) -> tuple[Change, ...]:
        """Significant changes."""
        return tuple(one for one in self.changes if one.significant)

    @property
    def sentence(self) -> str:
        """The verdict in a line."""
        return self.verdict[0]

    def to_document(self, *, details: bool = False, pictures: bool = False) -> Document:
        """Return the report; `details` gives all rows, `pictures` adds plots."""
        most = None if details else _SHOWN
        counts = Counter(row.outcome for row in self.rows)
        ends = ", ".join(f"{count} {outcome}" for outcome in Outcome if (count := counts[outcome]))
        blocks: list[Block] = [
            Text(self.sentence, style=_TONES[self.verdict[1]]),
            Facts((("cases", f"{len(self.rows)}: {ends}"),)),
            *(_pictures(self.drifted, self.series, self.losses) if pictures else ()),
            *self._loss_blocks(most),
            *self._drift_blocks(most),
            *_distributions(self.rows),
            *self._scatter_blocks(),
            *self._outlier_blocks(most),
            *_reasons(self.rows, most),
        ]
        return Document(f"Campaign {self.name}", tuple(blocks))

    def _loss_blocks(self, most: int | None) -> Iterator[Block]:
        if self.losses:
            yield Text("Lost", "heading")
            rows = tuple(map(_loss_row, self.losses[:most]))
            yield Table(("joint", "quantity", "last value", "runs without", "why"), rows, "", (0, 1, 2, 4))

    def _drift_blocks(self, most: int | None) -> Iterator[Block]:
        if not self.changes:
            return
        header = ("joint", "quantity", "change %", "2 sigma", "kind", "since", "p")
        if self.drifted:
            yield Text("Drifted", "heading")
            yield Table(header, tuple(map(_drift_row, self.drifted[:most])), "", (0, 1, 4, 5))
        others = [one for one in self.changes if not one.significant][:most]
        if others:
            yield Text("Largest changes within scatter", "heading")
            yield Table(header, tuple(map(_drift_row, others)), "", (0, 1, 4, 5))
        yield Text(
            f"{pluralise(len(self.changes), 'quantity', 'quantities')} of joints were watched; the chance that any is "
            f"named without drift is {number(100 * self.false_alarm, 2)} % at most, if the runs of a joint scatter "
            "independently of one another."
        )

    def _scatter_blocks(self) -> Iterator[Block]:
        """Yield the scatter between runs over the stated standard deviations."""
        found = defaultdict[str, list[float]](list)
        for one in self.series:
            if one.enough:
                found[one.quantity].append(one.scatter / float(np.median(one.stds)))
        if not found:
            return
        rows = []
        for quantity, ratios in sorted(found.items()):
            middle = float(np.median(ratios))
            verdict = "as stated" if _CAREFUL <= middle <= _LAX else "more than stated" if middle > _LAX else "less"
            rows.append((quantity, number(middle, 2), number(float(np.max(ratios)), 2), str(len(ratios)), verdict))
        yield Text("Scatter from run to run over the stated standard deviation", "heading")
        yield Table(("quantity", "median", "largest", "joints", "verdict"), tuple(rows), "", (0, 4))

    def _outlier_blocks(self, most: int | None) -> Iterator[Block]:
        runs = [
            (one.joint, one.quantity, one.labels[k], number(100 * (value / level - 1), 3, "+"), number(abs(off), 2))
            for one in self.series
            for level in [float(np.median(one.values))]
            for k, (value, off) in enumerate(zip(one.values, one.outlying, strict=True))
            if off
        ]
        if runs:
            yield Text("Runs that stand out from their joint", "heading")
            runs.sort(key=lambda row: -float(row[-1]))
            yield Table(("joint", "quantity", "run", "off %", "deviations"), tuple(runs[:most]), "", (0, 1, 2))


def _count_joints(names: Sequence[str], what: str) -> str:
    """Format how many joints changed, and their names."""
    joints = list(dict.fromkeys(names))
    named = [*joints[:_SHOWN], *([f"{len(joints) - _SHOWN} more"] if len(joints) > _SHOWN else [])]
    return f"{pluralise(len(joints), 'joint')} {what}: {join(named)}."


def _loss_row(one: Loss) -> tuple[str, ...]:
    why = short(one.sentence, _LONGEST)
    return name_series(one.joint, one.changes), one.quantity or "all", one.last or "-", str(one.runs), why


def _drift_row(one: Change) -> tuple[str, ...]:
    scale = 100 / abs(one.before) if one.before else float("inf")
    return (
        name_series(one.series.joint, one.series.changes), one.series.quantity, number(one.change_percent, 3, "+"),
        number(2 * scale * one.std, 2), one.kind, one.since, number(one.p_value, 2),
    )  # fmt: skip


def _distributions(rows: Sequence[Row]) -> Iterator[Block]:
    """Yield the distribution of each parameter, by combination of swept settings."""
    for changes in sorted({row.changes for row in rows}):
        tried = [row for row in rows if row.changes == changes]
        runs = [row for row in tried if row.outcome is Outcome.IDENTIFIED]
        if not runs:
            continue
        errors = [row.error_percent for row in runs if row.error_percent is not None]
        shown = list[tuple[str, ...]]()
        for name, unit in dict.fromkeys((name, one.unit) for row in runs for name, one in row.found.items()):
            found = [one for row in runs if (one := row.found.get(name)) is not None and one.unit == unit]
            values = np.array([one.value for one in found if one.value is not None], dtype=np.float64)
            stds = [one.std for one in found if one.std is not None]
            if values.size:
                spread = float(values.std(ddof=1)) if values.size > 1 else None
                cuts = [float(one) for one in np.quantile(values, (0.05, 0.5, 0.95))]
                stated = float(np.median(stds)) if stds else None
                shown.append((name, str(values.size), *map(number, cuts), number(spread, 3), number(stated, 3), unit))
        yield Text(f"Distribution: {'; '.join(changes)}" if changes else "Distribution", "heading")
        error = number(float(np.median(errors))) if errors else "-"
        words = f"{len(runs)} of {len(tried)} identified, median error {error} %"
        header = ("parameter", "runs", "5 %", "median", "95 %", "spread", "stated std", "unit")
        yield Table(header, tuple(shown), words, (0, 7))


def _reasons(rows: Sequence[Row], most: int | None) -> Iterator[Block]:
    """Yield the reasons for missing answers, cases set aside first."""
    without = [row for row in rows if row.outcome is not Outcome.IDENTIFIED]
    if not without:
        return
    yield Text("Without an answer", "heading")
    # Cases that killed workers come first: they must not be lost among many unreadable records.
    without.sort(key=lambda row: (row.outcome is not Outcome.SET_ASIDE, row.outcome is not Outcome.FAILED, row.place))
    whose = ((" ".join((row.joint, row.day, *row.changes)), row) for row in without[:most])
    yield Text("\n".join(f"{who}, {row.outcome}: {short(row.sentence, _LONGEST)}" for who, row in whose), "list")


_Shown: TypeAlias = tuple[Series, str, str, Change | None]
"""A series, its caption, the run that is marked, and its change, if any."""


def _pictures(changes: Sequence[Change], series: Sequence[Series], losses: Sequence[Loss]) -> Iterator[Block]:
    """Yield plots of drifted or lost quantities over days."""
    shown: list[_Shown] = [
        (one.series, f"{one.change_percent:+.3g} % since {one.since}", one.since, one) for one in changes
    ]
    for one in losses:
        for of in series:
            if (of.joint, of.changes) == (one.joint, one.changes) and one.quantity in ("", of.quantity):
                shown.append((of, f"no value after {one.last}", of.labels[-1], None))
    if shown:
        words = "Values of each run with 2 sigma over the days; the orange line is the level before and after a change."
        words += f" {_PANELS} of {len(shown)} are shown." * (len(shown) > _PANELS)
        yield Text("Values over the days", "heading")
        yield Picture("fleet-changes.svg", lambda: svg(_draw(shown[:_PANELS]), "fleet-changes"), words)


@styled
def _draw(shown: Sequence[_Shown]) -> Figure:
    """Draw series over days, with a marked run and levels."""
    figure, drawn = panels([220] * len(shown), 2)
    for axes, (of, said, since, change) in zip(drawn, shown, strict=True):
        days, at = of.days - of.days[0], of.labels.index(since)
        if change is not None:
            steps, levels = ([0, -1], [0, 1]) if change.kind == "trend" else ([0, at, at, -1], [0, 0, 1, 1])
            axes.plot(days[steps], np.array([change.before, change.after])[levels], color=SIMULATED, linewidth=1.5)
        mark(axes, float(days[at]), "")
        axes.errorbar(days, of.values, 2 * of.stds, fmt="o-", color=ERROR, linewidth=0.2, markersize=3, ecolor=MEASURED)
        title = f"{of.joint}, {of.quantity.replace('_', ' ')}: {said}"
        axes.set(xlabel=f"days since {of.labels[0]}", ylabel=of.unit or "value", title=title)
        axes.set_xlim(-0.5, float(days[-1]) + 0.5)
    return figure
