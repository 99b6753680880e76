"""Clauses that state the faults that were found of an axis, from the rows of their table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jointid.common.text import number
from jointid.diagnostics.faults.fault import MICROSECOND, FaultTest, Measure

if TYPE_CHECKING:
    from jointid.diagnostics.faults.findings import AxisFaults, Finding, OtherLaw

_UNITS = ("torque", "position", "velocity")


def state(finding: Finding, check: AxisFaults, *, spread: bool) -> str:
    """Return the clause that states a fault, its size and, with `spread`, its interval; "" of one without words."""
    test, fault = finding.test, finding.test.fault
    if finding.law is not None:
        return _state_laws(finding, check)
    if not fault.says:
        return _state_number(test, spread=spread)
    units = {name: check.on_side(name) for name in _UNITS}
    size = _show_size(test, units, spread=spread)
    value, shape = finding.value or test.shape, "" if test.shape is None else number(test.shape, 2)
    said = fault.says.format(
        size=size, by=f", by {size}" if size else "", of=f" of {size}" if size else "", shape=shape,
        value=number(value, 4), sense=fault.senses[test.size < 0], phrase=fault.phrase, **units,
    )  # fmt: skip
    return " ".join(said.split())


def _show_size(test: FaultTest, units: dict[str, str], *, spread: bool) -> str:
    """Return the size and, with `spread`, its interval; "" where the interval contains 0."""
    if 2 * test.std >= abs(test.size):
        return ""
    measure, (unit, factor) = test.fault.measure, ("%", 100.0)
    if measure is Measure.TIME:
        unit, factor = ("ms", 1e3) if abs(test.size) >= MICROSECOND else ("us", 1e6)
    elif measure is not Measure.SHARE:
        unit, factor = units.get(measure.value, ""), 1.0
    interval = f" ± {number(2 * factor * test.std, 2)}" if spread else ""
    return f"{number(abs(factor * test.size), 3 if spread else 2)}{interval} {unit}"


def _state_number(test: FaultTest, *, spread: bool) -> str:
    """Return the clause on the difference of a number from its declaration, in percent of that.

    A sensitivity is no guide to a change as large as the number itself.
    """
    name, share, deviation = test.fault.phrase, test.size / abs(test.declared), 2 * test.std / abs(test.declared)
    if not -1 < share <= 1:
        return f"torque, reference, ratio or a gain is wrong by a factor, or has the wrong sign ({name} is the nearest)"
    way = "smaller" if share < 0 else "larger"
    if deviation >= abs(share):
        return f"{name} is {way} than declared, by how much this record does not tell"
    interval = f" ± {number(100 * deviation, 2)}" if spread else ""
    return f"{name} is {number(100 * abs(share), 2)}{interval} % {way} than declared"


def state_periods(periods: list[float]) -> tuple[str, str]:
    """Return the clause on a drive of one of these periods, and what to declare; the slowest is the first."""
    each = sorted(periods, reverse=True)
    rates, times = (" or ".join(f"{1e-3 / p:.4g}" for p in each), " or ".join(f"{1e3 * p:.4g}" for p in each))
    return f"the controller runs faster than the log, at {rates} kHz", f"its period, {times} ms"


def _state_laws(finding: Finding, check: AxisFaults) -> str:
    """Return the clause on another law of the drive, and on equally good ones; rates of one law are joined.

    A law that is reported as undecided is not repeated. Rates that the record does not tell apart are equals: which of
    them leaves least is chance.
    """
    assert finding.law is not None
    of_each: dict[tuple[str, str | None], list[OtherLaw]] = {}
    for one in (finding.law, *(other for other in finding.alike if other != check.open_law)):
        of_each.setdefault((one.fault.name, getattr(one.controller, "interpolation", None)), []).append(one)
    stated = []
    for first, *others in of_each.values():
        texts = first.words, first.remedy
        if others and first.rate:
            alone, every = (state_periods([1 / law.rate for law in laws]) for laws in ([first], [first, *others]))
            texts = texts[0].replace(alone[0], every[0]), texts[1].replace(alone[1], every[1])
        stated.append(texts)
    (said, remedy), *more = stated
    said = f"{said}: declare {remedy}"
    return said + "".join(f"; or {one}, which this record does not tell apart: {its}" for one, its in more)
