"""Groups of comparable runs: repetitions with or without a known truth, many starts and swept settings.

For normal estimates, ``(n - 1) s^2`` over the variance is chi-square with n - 1 degrees of freedom, which gives the
interval of the scatter s of n runs over the median stated deviation. Limits: an outlier widens s, and is reported; a
bias does not scatter.

The bias of n simulated runs is their mean error, with the deviation of scatter over sqrt(n). Two standard deviations
cover 95.45 % of normal estimates; the observed coverage has a binomial interval (C. J. Clopper and E. S. Pearson,
Biometrika 26, 1934). Bias or low coverage is reported at a campaign-wide error rate of 1 % (Bonferroni). Limits: few
faults are significant below thirty runs; the truth is the simulation's, not a machine's.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from jointid.campaigns.cases import Outcome, Row
from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Heading, Paragraph, Table
from jointid.common.errors import RecordError
from jointid.common.text import format_signed, join, number, pluralise

_FEWEST = 3  # runs that have a scatter
_LEVEL = 0.95  # of its interval, and of that of a coverage
_CLOSE = 1.1  # a ratio that is no other, however surely it is known
_OUT = 6.0  # robust deviations above which a run stands out
_NAMED = 5  # quantities in a sentence
_TO_SIGMA = 1.4826  # from the median of absolute deviations, for a normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class Repeated:
    """A quantity over runs that differ in their seed alone.

    Attributes:
        name: of the quantity, with the swept settings of these runs.
        seeds: (runs,) of each.
        values: (runs,) in SI units.
        stds: (runs,) stated standard deviations.
        truth: where it is known, and of all runs the same.
    """

    name: str
    seeds: tuple[int | None, ...]
    values: FloatArray
    stds: FloatArray
    unit: str = ""
    truth: float | None = None

    @property
    def ratio(self) -> float:
        """Scatter over the median stated standard deviation."""
        return float(np.std(self.values, ddof=1) / np.median(self.stds))

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the ratio, of 95 %."""
        from scipy.special import chdtri

        freedom = self.values.size - 1
        lower, upper = (
            self.ratio * math.sqrt(freedom / float(chdtri(freedom, (1 - sign * _LEVEL) / 2))) for sign in (1, -1)
        )
        return lower, upper

    @property
    def verdict(self) -> str:
        """Whether the scatter agrees with the stated deviations."""
        lower, upper = self.interval
        if lower > 1 and self.ratio > _CLOSE:
            return "more than stated"
        return "less" if upper < 1 and self.ratio < 1 / _CLOSE else "as stated"

    @property
    def outlying(self) -> Iterator[tuple[int | None, float, float]]:
        """Seed, value and deviations of each outlier."""
        off = self.values - np.median(self.values)
        scale = max(_TO_SIGMA * float(np.median(np.abs(off))), float(np.median(self.stds)))
        for k in np.flatnonzero(np.abs(off) > _OUT * scale):
            yield self.seeds[k], float(self.values[k]), float(off[k] / scale)


def repeats_of(rows: Sequence[Row]) -> Iterator[Repeated]:
    """Yield every quantity of three or more runs with different seeds."""
    groups: dict[tuple[str, tuple[str, ...]], list[tuple[int | None, float, float]]] = {}
    units, truths = dict[str, str](), dict[tuple[str, tuple[str, ...]], set[float | None]]()
    for row in rows:
        if row.outcome is Outcome.IDENTIFIED:
            for name, one in row.found.items():
                if one.value is not None and one.std:
                    groups.setdefault((name, row.changes), []).append((row.seed, one.value, one.std))
                    truths.setdefault((name, row.changes), set()).add(row.truth.get(name))
                    units[name] = one.unit
    for (name, changes), runs in sorted(groups.items(), key=lambda one: one[0][1]):
        if len(runs) >= _FEWEST:
            seeds, values, stds = zip(*runs, strict=True)
            called = f"{name} ({'; '.join(changes)})" if changes else name
            known = truths[name, changes]
            truth = next(iter(known)) if len(known) == 1 else None
            yield Repeated(called, seeds, np.array(values), np.array(stds), units[name], truth)


def summarise_repeats(found: Sequence[Repeated], runs: int, what: str) -> tuple[str, bool | None]:
    """State whether runs scatter as stated; None if unknown."""
    if not found:
        return f"{pluralise(runs, f'{what} run')} with an answer; three are needed to say how they scatter.", None
    wrong = [one for one in found if one.verdict != "as stated"]
    if not wrong:
        return f"{pluralise(runs, f'{what} run')} scatter as their stated deviations say.", True
    said = [f"{one.name} ({number(one.ratio, 2)} times as stated)" for one in wrong[:_NAMED]]
    more = [f"{len(wrong) - _NAMED} more"] if len(wrong) > _NAMED else []
    return f"{pluralise(runs, f'{what} run')} scatter otherwise than stated in {join([*said, *more])}.", False


def repeat_blocks(found: Sequence[Repeated], most: int | None) -> Iterator[Block]:
    """Yield scatter against stated deviations, and outliers."""
    if found:
        yield Heading("Scatter between the runs over the stated standard deviation")
        scatter = ((one.name, str(one.values.size), number(one.ratio, 3), " to ".join(number(end, 3) for end in
                   one.interval), one.verdict) for one in found)  # fmt: skip
        yield Table(("quantity", "runs", "ratio", "95 %", "verdict"), tuple(scatter), "", (0, 3, 4))
    outlying = [
        (one.name, f"seed {seed}", number(value), format_signed(off, 2))
        for one in found
        for seed, value, off in one.outlying
    ]  # fmt: skip
    if outlying:
        yield Heading("Runs that stand out from the others")
        outlying.sort(key=lambda row: -abs(float(row[-1])))
        yield Table(("quantity", "run", "value", "deviations"), tuple(outlying[:most]), "", (0, 1))


_SIGMAS = 2.0
_STATED = math.erf(_SIGMAS / math.sqrt(2))
_CHANCE = 0.01  # that any quantity is called faulty where none is
_SMALL = 0.2  # stated deviations: a bias that moves no interval by much, however surely it is known


@dataclass(frozen=True, slots=True)
class AgainstTruth:
    """A simulated quantity against its truth; see `against_truth`.

    Attributes:
        name: of the quantity, with the swept settings of these runs.
        unit: of truth, bias, its deviation, scatter and stated deviation.
        stated: median of the standard deviations that they state.
        held: in how many runs two stated deviations held the truth.
        low, high: range of the share of these, of 95 %.
        biased: whether the bias is sure, and more than a fifth of the stated deviation.
        too_seldom: whether the truth is surely held less often than 95.45 %.
    """

    name: str
    unit: str
    runs: int
    truth: float
    bias: float
    bias_std: float
    scatter: float
    stated: float
    held: int
    low: float
    high: float
    biased: bool
    too_seldom: bool

    @property
    def share(self) -> float:
        """Coverage: share of runs whose interval holds the truth."""
        return self.held / self.runs

    @property
    def verdict(self) -> str:
        """Whether errors agree with the stated deviations."""
        faults = [said for said, so in (("biased", self.biased), ("held too seldom", self.too_seldom)) if so]
        return join(faults) if faults else "as stated"


def against_truth(found: Sequence[Repeated]) -> tuple[AgainstTruth, ...]:
    """Repeated quantities with known truth."""
    from scipy import stats

    known = [(one, one.truth) for one in found if one.truth is not None]
    compared = []
    for one, truth in known:
        chance = _CHANCE / len(known)
        runs, errors = one.values.size, one.values - truth
        bias, scatter, stated = float(errors.mean()), float(errors.std(ddof=1)), float(np.median(one.stds))
        held = int(np.count_nonzero(np.abs(errors) <= _SIGMAS * one.stds))
        share = stats.binomtest(held, runs).proportion_ci(_LEVEL, "exact")
        sure = abs(bias) > float(stats.t.isf(chance / 2, runs - 1)) * scatter / math.sqrt(runs)
        compared.append(
            AgainstTruth(
                one.name, one.unit, runs, truth, bias, scatter / math.sqrt(runs), scatter, stated, held,
                float(share.low), float(share.high), sure and abs(bias) > _SMALL * stated,
                float(stats.binomtest(held, runs, _STATED, "less").pvalue) < chance,
            )
        )  # fmt: skip
    return tuple(compared)


def summarise_truth(found: Sequence[AgainstTruth]) -> tuple[str, bool]:
    """State whether the intervals cover the truth."""
    seldom = [f"{one.name} ({100 * one.share:.0f} %)" for one in found if one.too_seldom]
    biased = [
        f"{one.name} ({format_signed(one.bias / one.stated, 2)} stated deviations)" for one in found if one.biased
    ]
    said = []
    if seldom:
        said.append(f"Two stated deviations hold the truth less often than they say in {join(seldom)}.")
    if biased:
        said.append(f"Biased: {join(biased)}.")
    return " ".join(said) or "Two stated deviations hold the truth as often as they say, and no bias is sure.", not said


def truth_blocks(found: Sequence[AgainstTruth]) -> Iterator[Block]:
    """Yield bias, scatter and coverage of quantities with known truth."""
    if not found:
        return
    yield Heading("Errors against the truth")
    header = ("quantity", "truth", "bias", "±", "scatter", "held %", "95 %", "verdict")
    rows = (
        (
            one.name, number(one.truth), format_signed(one.bias, 2), number(2 * one.bias_std, 2),
            number(one.scatter, 2), number(100 * one.share, 3), f"{100 * one.low:.0f} to {100 * one.high:.0f}",
            one.verdict,
        )
        for one in found
    )  # fmt: skip
    yield Table(header, tuple(rows), "", (0, 6, 7))
    yield Paragraph(
        "The bias is known to ±, two of its standard deviations; units are those of the distribution. "
        f"Held: the share of the runs whose two stated deviations have the truth in them, {100 * _STATED:.1f} % "
        f"if they are right. The chance that any of {pluralise(len(found), 'quantity', 'quantities')} is called biased "
        f"without being so is {100 * _CHANCE:.0f} % at most, and that one is called held too seldom the same."
    )


def truth_csv(found: Sequence[AgainstTruth]) -> str:
    """Bias, scatter and coverage as CSV, a row per quantity."""
    if not found:
        raise RecordError(
            "--csv has the errors against the truth, and these runs have none that is known; it needs [monte_carlo] "
            "with three runs or more: leave it out, or see jointid campaign export."
        )
    made = io.StringIO(newline="")
    writer = csv.writer(made, lineterminator="\n")
    writer.writerow(
        ("quantity", "unit", "runs", "truth", "bias", "bias std", "scatter", "stated std", "held", "share held",
         "share low", "share high", "verdict")
    )  # fmt: skip
    for one in found:
        writer.writerow(
            (one.name, one.unit, one.runs, one.truth, one.bias, one.bias_std, one.scatter, one.stated, one.held,
             one.share, one.low, one.high, one.verdict)
        )  # fmt: skip
    return made.getvalue()


_ALIKE = 0.1  # stated deviations, by which two ends may differ and be one
_ALIKE_WITHOUT = 1e-4  # relative, of a parameter without a deviation


@dataclass(frozen=True, slots=True)
class SearchEnd:
    """An optimum and the searches that reached it.

    Attributes:
        changes: swept settings that these searches have in common.
        best: the search of them that has the least error.
    """

    changes: tuple[str, ...]
    best: Row
    searches: tuple[Row, ...]


def ends_of(rows: Sequence[Row]) -> tuple[tuple[SearchEnd, ...], ...]:
    """Optima of every combination of settings, by error."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        if row.outcome in (Outcome.IDENTIFIED, Outcome.DOUBTFUL):  # a search may end where nothing fits
            groups.setdefault(row.changes, []).append(row)
    found = []
    for changes, runs in sorted(groups.items()):
        ends: list[list[Row]] = []
        runs.sort(key=lambda row: (math.inf if row.error_percent is None else row.error_percent, row.place))
        for row in runs:
            there = next((end for end in ends if _largest_distance(end[0], row)[0] <= 1), None)
            if there is None:
                ends.append([row])
            else:
                there.append(row)
        found.append(tuple(SearchEnd(changes, end[0], tuple(end)) for end in ends))
    return tuple(found)


def _largest_distance(best: Row, row: Row) -> tuple[float, str]:
    """Largest parameter difference of two optima, relative to tolerance, and its name."""
    most = (0.0, "")
    for name in {**best.found, **row.found}:
        one, other = best.found.get(name), row.found.get(name)
        values = [each.value for each in (one, other) if each is not None and each.value is not None]
        if len(values) < 2:  # refused in one of the two; in both it is alike
            if values:
                return float("inf"), name
            continue
        assert one is not None
        scale = _ALIKE * one.std if one.std else _ALIKE_WITHOUT * abs(values[0])
        apart = abs(values[1] - values[0])
        most = max(most, (apart / scale if scale else float("inf") if apart else 0.0, name))
    return most


def summarise_ends(groups: Sequence[Sequence[SearchEnd]]) -> tuple[str, bool | None]:
    """State how many searches reached the best fit, and whether all did."""
    if not groups:
        return "No search has come to an answer.", None
    alike = sum(len(ends[0].searches) for ends in groups)
    total = sum(len(end.searches) for ends in groups for end in ends)
    said = f"{alike} of {pluralise(total, 'search', 'searches')} ended at the best fit"
    return (f"{said}." if alike == total else f"{said}, the others elsewhere."), alike == total


def end_blocks(groups: Sequence[Sequence[SearchEnd]], most: int | None) -> Iterator[Block]:
    """Yield the parameters of the best fit, and the optima side by side."""
    for ends in groups:
        best = ends[0].best
        of = f": {'; '.join(ends[0].changes)}" if len(groups) > 1 else ""
        yield Heading(f"Best of the starts{of}")
        found = ((name, number(one.value), number(one.std, 3), one.unit) for name, one in best.found.items())
        yield Table(("parameter", "value", "std", "unit"), tuple(found), "", (0, 3))
        yield Heading(f"Where the searches ended{of}")
        rows = []
        for end in ends[:most]:
            apart, name = _largest_distance(best, end.best)
            far = "-" if end.best is best else f"{number(_ALIKE * apart, 3)} in {name}"
            error = "-" if end.best.error_percent is None else number(end.best.error_percent)
            rows.append((str(len(end.searches)), error, f"seed {end.best.seed}", far))
        yield Table(("searches", "error %", "first", "deviations from the best"), tuple(rows), "", (2, 3))


_Run: TypeAlias = tuple[str, str, str, int | None, tuple[str, ...]]


def sweep_blocks(rows: Sequence[Row], most: int | None) -> Iterator[Block]:
    """Yield the effect of each value of a swept setting.

    Numbers are relative to the least value: the median over pairs of runs, in per cent and in stated standard
    deviations.
    """
    settings: dict[str, dict[str, dict[_Run, Row]]] = {}
    for row in rows:
        for change in row.changes:
            key, _, value = change.partition("=")
            others = tuple(one for one in row.changes if one != change)
            run = (row.joint, row.record, row.day, row.seed, others)
            settings.setdefault(key, {}).setdefault(value, {})[run] = row
    ends, effects = list[tuple[str, ...]](), list[tuple[str, ...]]()
    for key, by_value in settings.items():
        values = sorted(by_value, key=_sort_key)
        if len(values) < 2:  # set for all, and not swept
            continue
        for value in values:
            done = [row for row in by_value[value].values() if row.outcome is Outcome.IDENTIFIED]
            errors = [row.error_percent for row in done if row.error_percent is not None]
            error = number(float(np.median(errors))) if errors else "-"
            ends.append((f"{key}={value}", f"{len(done)} of {len(by_value[value])}", error))
        for value in values[1:]:
            effects += _effects(f"{key}={value} for {values[0]}", by_value[values[0]], by_value[value])
    if ends:
        yield Heading("Swept settings")
        yield Table(("setting", "identified", "error %"), tuple(ends), "", (0, 1))
    if effects:
        yield Heading("Effect of each swept setting")
        header = ("setting", "parameter", "effect %", "deviations", "pairs")
        yield Table(header, tuple(effects[:most]), "", (0, 1))


def _sort_key(value: str) -> tuple[float, str]:
    try:
        return float(value), value
    except ValueError:
        return float("inf"), value


def _effects(what: str, before: dict[_Run, Row], after: dict[_Run, Row]) -> Iterator[tuple[str, ...]]:
    """Yield the change of each parameter between two values of a setting."""
    pairs = [(before[run].found, after[run].found) for run in before if run in after]
    for name in dict.fromkeys(name for found, _ in pairs for name in found):
        moved = [
            (other.value - one.value, one.value, one.std)
            for found, again in pairs
            if (one := found.get(name)) and (other := again.get(name))
            and one.value is not None and other.value is not None
        ]  # fmt: skip
        percent = [100 * change / abs(value) for change, value, _ in moved if value]
        deviations = [change / std for change, _, std in moved if std]
        if moved:
            yield (
                what, name, format_signed(float(np.median(percent)), 3) if percent else "-",
                format_signed(float(np.median(deviations)), 2) if deviations else "-", str(len(moved)),
            )  # fmt: skip
