"""Smallest change of a joint that the same motion detects, at a false-alarm rate.

Two records of the same motion and noise give estimates of a quantity with standard deviation s each, whose difference
has sqrt(s1^2 + s2^2), that is s sqrt(2). A change is detected if the difference exceeds ``z(1 - a/2) sqrt(s1^2 +
s2^2)``, z the normal quantile, a the false-alarm rate. With a probability p this happens for ::

    change = (z(1 - a/2) + z(p)) sqrt(s1^2 + s2^2)

(power of a two-sided test without the wrong tail). The deviations include repeatable errors, which cancel in the
difference, so the result is conservative. Variation between records, as of friction with temperature, counts as change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

from jointid.common.document import Document, Documented, Table
from jointid.common.errors import MethodError
from jointid.common.text import number
from jointid.estimation.result.estimate import Estimate


@dataclass(frozen=True, slots=True)
class DetectableChange:
    """Smallest detectable change of one quantity.

    Attributes:
        name: of a parameter, or of a sum in words. formula: in symbols. unit: of both.
        value: in the estimate. std: its deviation there.
        size: the smallest change that is detected with the stated power.
        limit: of the difference of two estimates, above which a change is reported.
    """

    name: str
    formula: str
    unit: str
    value: float
    std: float
    size: float
    limit: float


@dataclass(frozen=True, slots=True)
class MinimumDetectableChange(Documented):
    """Smallest detectable changes of a joint.

    Attributes:
        false_alarm: share of comparisons that report a change where there is none.
        power: share that report one where there is one of that size.
        changes: of each identified parameter, and of the sums and differences of both sides.
    """

    record: str
    false_alarm: float
    power: float
    changes: tuple[DetectableChange, ...]

    def __getitem__(self, name: str) -> DetectableChange:
        """Return the change of a quantity by its name or formula."""
        for change in self.changes:
            if name in (change.name, change.formula):
                return change
        raise KeyError(name)

    def document(self, *, details: bool = False) -> Document:
        """Table of the changes."""
        del details
        rows = tuple(
            (c.formula, c.name, number(c.value), number(c.size, 2), _percent(c), number(c.limit, 2), c.unit)
            for c in self.changes
        )
        header = ("symbol", "quantity", "value", "detectable", "%", "alarm above", "unit")
        said = (
            f"Smallest change detectable with another record of this motion ({100 * self.false_alarm:g} % false "
            f"alarms, {100 * self.power:g} % detected)"
        )
        return Document(said, (Table(header, rows, words=(0, 1, 6)),))


def compute_minimum_detectable_change(
    estimate: Estimate, *, false_alarm: float = 0.01, power: float = 0.9
) -> MinimumDetectableChange:
    """Compute the smallest detectable change of each quantity.

    Args:
        estimate: of a record; a new one is taken to have the same motion and noise.
        false_alarm: share of comparisons in which a change is reported where there is none, two-sided.
        power: share in which one is reported where there is one.

    Limits: a change so large that the estimate's slopes are others at its end is detected a little sooner or later; one
    that a friction law of another shape makes is not a change of these parameters.
    """
    if not (0 < false_alarm < 1 and 0.5 <= power < 1):
        raise MethodError(
            f"A false-alarm rate is between 0 and 1, and a power from 0.5 to 1; received {false_alarm} and {power}."
        )
    normal = NormalDist()
    alarm = normal.inv_cdf(1 - false_alarm / 2)
    both = alarm + normal.inv_cdf(power)
    quantities = [
        (p.name, p.symbol, p.unit, p.value, p.stderr)
        for p in estimate.params.rows
        if p.of_joint and p.value is not None and p.stderr
    ]
    if estimate.checks.known is not None:
        quantities += [
            (k.combination.name, k.combination.formula, k.combination.unit, k.value, k.std)
            for k in estimate.checks.known.physical
        ]
    if not quantities:
        raise MethodError(
            f"The estimate of {estimate.data.record} has no deviations, so no detectable change can be computed; "
            "identify by least squares."
        )
    changes = tuple(
        DetectableChange(name, formula, unit, value, std, both * math.sqrt(2) * std, alarm * math.sqrt(2) * std)
        for name, formula, unit, value, std in quantities
    )
    return MinimumDetectableChange(estimate.data.record, false_alarm, power, changes)


def _percent(change: DetectableChange) -> str:
    return number(100 * change.size / abs(change.value), 2) if change.value else "-"
