"""Simulated runs against their truth: bias, scatter and coverage of intervals.

The bias of n runs is their mean error, with the deviation of scatter over sqrt(n). Two standard deviations cover 95.45
% of normal estimates; the observed coverage has a binomial interval (C. J. Clopper and E. S. Pearson, Biometrika 26,
1934). Bias or low coverage is reported at a campaign-wide error rate of 1 % (Bonferroni). Limits: few faults are
significant below thirty runs; the truth is the simulation's, not a machine's.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.campaigns.run_groups import Repeated
from jointid.common.document import Block, Heading, Paragraph, Table
from jointid.common.errors import RecordError
from jointid.common.text import format_signed, join, number, pluralise

_SIGMAS = 2.0
_STATED = math.erf(_SIGMAS / math.sqrt(2))
_LEVEL = 0.95  # of the range of the share
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
    known = [one for one in found if one.truth is not None]
    return tuple(_beside(one, one.truth, _CHANCE / len(known)) for one in known if one.truth is not None)


def _beside(one: Repeated, truth: float, chance: float) -> AgainstTruth:
    from scipy import stats

    runs, errors = one.values.size, one.values - truth
    bias, scatter, stated = float(errors.mean()), float(errors.std(ddof=1)), float(np.median(one.stds))
    held = int(np.count_nonzero(np.abs(errors) <= _SIGMAS * one.stds))
    share = stats.binomtest(held, runs).proportion_ci(_LEVEL, "exact")
    sure = abs(bias) > float(stats.t.isf(chance / 2, runs - 1)) * scatter / math.sqrt(runs)
    return AgainstTruth(
        one.name, one.unit, runs, truth, bias, scatter / math.sqrt(runs), scatter, stated, held, float(share.low),
        float(share.high), sure and abs(bias) > _SMALL * stated,
        float(stats.binomtest(held, runs, _STATED, "less").pvalue) < chance,
    )  # fmt: skip


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
    header = ("quantity", "truth", "bias", "+-", "scatter", "held %", "95 %", "verdict")
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
        "The bias is known to +-, two of its standard deviations; units are those of the distribution. "
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
