"""Faults of one axis: what each is, its test, and those found, with the sentences that state them.

A fault is tested as a small deviation by its signatures. All that is particular to it is a field of `Fault`; the tests
and the report read these fields. What corrects a large one is in `changes`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.common.transmission import Side
from jointid.diagnostics.in_time import Part
from jointid.diagnostics.seen import Columns, Seen
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.parts import format_signed
from jointid.estimation.result.verdict import Reason
from jointid.models.controllers import Controller
from jointid.models.friction import StribeckFriction

MICROSECOND = 1e-6
"""Seconds: a shorter time is not given in ms."""
_SMALLEST_SHIFT = 0.5  # of a deviation: a smaller change of a parameter is not listed
_LISTED = 3  # parameters in a sentence, at most


class Measure(StrEnum):
    """Unit in which a table shows the size of a fault."""

    SHARE = "%"
    TIME = "ms"
    TORQUE = "torque"
    POSITION = "position"
    DECLARED = "% of the declared value"


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault of the loop, the log or the mechanics: one row of one table, for joint and robot.

    Attributes:
        name: its code.
        title: noun phrase, without an article.
        says: clause that states it: with {size}, or its ends {by} and {of}, {shape}, {value}, the first of its `senses`
            of a positive size as {sense}, and {torque}, {position} and {velocity} as units; see `findings`.
        senses: of a positive size, and of a negative one.
        remedy: what else to declare, as the end of a sentence, with {shape}.
        columns: returns what it adds to the torque of an axis, in each of its shapes.
        tried: number of shapes that each of its columns is the best of.
        parts: numbers that are fitted for a column: 2 of a wave of any phase.
        declared: value without the fault; None for a number of the controller, whose value is declared.
        one_sided: whether its size can only be positive.
        least: smallest size that is named: less is within what such a part is known to.
        mechanical: whether it is a fault of the joint's model, not of loop or log.
        last: whether it is named only where no other fault is collinear.
        kin: group of faults that describe one effect; after one is found, the others are not tested.
        measure: unit of its size in a table.
        reason: code of the verdict.
        table: table of the joint file that declares a law with it.
        laws: names of these laws.
    """

    name: str
    title: str
    says: str = ""
    senses: tuple[str, str] = ("larger", "smaller")
    remedy: str = ""
    columns: Callable[[Seen], Columns] | None = None
    tried: int = 1
    parts: int = 1
    declared: float | None = 0.0
    one_sided: bool = False
    least: float = 0.0
    mechanical: bool = False
    last: bool = False
    kin: str = ""
    measure: Measure = Measure.DECLARED
    reason: Reason = Reason.LOOP_NOT_AS_DECLARED
    table: Literal["", "spring", "friction"] = ""
    laws: tuple[str, ...] = ()

    @property
    def of_model(self) -> bool:
        """True of a fault of the joint's mechanics or friction, False of one of loop and log."""
        return self.mechanical or bool(self.table)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True, eq=False)
class FaultSignature:
    """Change of the torque by one fault.

    Attributes:
        fault: that makes it.
        column: (rows,) change of the filtered torque per unit of its size: a derivative, or a secant.
        shape: the level of a limit, a Stribeck speed, a gap or a frequency; None without a shape.
        raw: (samples,) the column before the filter, if no parameter of the problem stands for the fault.
        axis: that has it.
        trial: the problem of the joint with it, and (free,) a start, if a law of the joint has it.
    """

    fault: Fault
    column: FloatArray
    shape: float | None = None
    raw: FloatArray | None = None
    axis: int = 0
    trial: tuple[ClosedLoopProblem, FloatArray] | None = None


@dataclass(frozen=True, slots=True)
class FaultTest:
    """Test of one fault.

    Attributes:
        fault: that is tested.
        alike: faults that no record of this loop can distinguish from it.
        declared: value; 0 for what is not declared at all.
        size: value less the declared one; of a limit, the observed share of what it cuts off.
        std: standard deviation of the size, autocorrelation-robust.
        statistic: their ratio.
        p_value: adjusted for all tests of the record together.
        shape: the level of a limit in the torque's unit, or a Stribeck speed.
        opposite: those of `alike` whose size has the opposite sign.
        axis: that has it.
    """

    in_json = "name -fault -alike -opposite -axis"
    fault: Fault
    alike: tuple[Fault, ...]
    declared: float
    size: float
    std: float
    statistic: float
    p_value: float
    shape: float | None = None
    opposite: tuple[Fault, ...] = ()
    axis: int = 0

    @property
    def name(self) -> str:
        """Code of the fault."""
        return self.fault.name

    @property
    def label(self) -> str:
        """Codes of the fault and of those it cannot be distinguished from."""
        return " or ".join(one.name for one in (self.fault, *self.alike))

    @property
    def strength(self) -> float:
        """The absolute statistic; at least 0 for a fault that can only be positive."""
        return max(self.statistic, 0.0) if self.fault.one_sided else abs(self.statistic)


def name_number(name: str) -> str:
    """Return a number's name in words, also a filter's: "time constant of the velocity filter"."""
    *owner, last = name.replace("_", " ").split(".")
    if len(owner) == 2:  # one of several, which are counted
        return f"{last} of {owner[0].removesuffix('s')} {owner[1]}"
    return f"{last} of the {owner[0]}" if owner else last


def milliseconds(seconds: float) -> str:
    """Return a time in ms; one that no drive keeps is 0."""
    return "0" if abs(seconds) < MICROSECOND else number(1e3 * seconds, 2)


@dataclass(frozen=True, slots=True)
class ParameterShift:
    """Change of a parameter when a fault is corrected: in its unit, and in its standard deviations."""

    by: float
    sigmas: float


@dataclass(frozen=True, slots=True)
class OtherLaw:
    """A law that a drive may run instead of the declared one.

    Attributes:
        fault: what differs.
        words: clause on what the drive does.
        remedy: its declaration.
        controller: with that law.
        rate: of the law, Hz, if that differs.
    """

    fault: Fault
    words: str
    remedy: str
    controller: Controller
    rate: float = 0.0


@dataclass(frozen=True, slots=True)
class Finding:
    """Fault that was found.

    Attributes:
        test: of the fault, those found before it corrected.
        value: estimated, in the unit of the declaration; None where no parameter stands for the fault.
        rivals: tests of faults that are at most 20 times less likely.
        changes: of the joint's parameters, by name, when it is corrected.
        law: that the drive runs instead of the declared one, where that is the fault.
        left: residual share of the filtered torque under that law, or with that fault in the joint.
        alike: equally good laws, the likeliest first.
    """

    in_json = "-law -alike"
    test: FaultTest
    value: float | None
    rivals: tuple[FaultTest, ...]
    changes: Mapping[str, ParameterShift]
    law: OtherLaw | None = None
    left: float | None = None
    alike: tuple[OtherLaw, ...] = ()

    @property
    def values(self) -> dict[str, object]:
        """The numbers of its message."""
        test = self.test
        changes = {name: change.by for name, change in self.changes.items()}
        return {"size": test.size, "std": test.std, "p_value": test.p_value, "changes": changes}


@dataclass(frozen=True, slots=True)
class AxisFaults:
    """Faults of one axis that were found, and the tests of all.

    Attributes:
        findings: faults found, the likeliest first.
        tests: of every fault as if it were the only one, the likeliest first.
        level: largest share of records without a fault in which one is found.
        symbols: of the joint's parameters, by name.
        units: of the joint's parameters by name, and of "torque", "position" and "velocity".
        side: of the transmission, on which all of these numbers are; None without one.
        undecided: another law that the record does not exclude, and that would shift a parameter out of its interval.
        laws: names of springs and nonlinear frictions that can replace those of the joint.
        of_loop: whether faults of the loop were tested, which needs its simulation.
        suspected: faults that are not named, and whose shifts the intervals hold. One of the mechanics that is
            significant at the level of those of the loop, not at its own tenth of that; or, where none was found, one
            of loop or log that the motor position excludes: the joint has what looks like it.
        part: of the time in which the residual is concentrated, faults corrected; no fault is named beside it.
        explained: share of the squares of the residual that the faults explain together, where so many were found that
            none of them is likely to be the cause.
    """

    findings: tuple[Finding, ...]
    tests: tuple[FaultTest, ...]
    level: float
    symbols: Mapping[str, str]
    units: Mapping[str, str]
    side: Side | None = None
    undecided: Finding | None = None
    laws: tuple[str, ...] = ()
    of_loop: bool = True
    suspected: tuple[Finding, ...] = ()
    part: Part | None = None
    explained: float | None = None

    @property
    def as_declared(self) -> bool:
        """True if no fault was found."""
        return not self.findings and self.part is None

    @property
    def good(self) -> bool | None:
        """True if loop and log are as declared; None where another law would matter that is not excluded."""
        return None if self.as_declared and self.undecided is not None else self.as_declared

    @property
    def reasons(self) -> tuple[Message, ...]:
        """The faults found, one message each; one that says so where there are none."""
        if self.part is not None:
            return (self.part.reason,)
        if self.explained is not None:
            clause = "something is wrong that is none of the known faults"
            share, alike = number(100 * self.explained, 2), ", ".join(_call(one.test.fault) for one in self.findings)
            words = f"{clause}: {alike} together explain {share} % of the squares of the residual"
            return (Message(Reason.NO_CAUSE_FOUND, words, {"explained": self.explained}, clause),)
        undecided = () if self.undecided is None else (self._describe_open_law(self.undecided),)
        if self.findings or undecided:
            return (*map(self._describe, self.findings), *undecided)
        least = min((s.p_value for s in self.tests), default=1.0)
        names = ", ".join(" or ".join(one.title for one in (s.fault, *s.alike)) for s in self.tests)
        said = f"loop and log are as declared as far as this record shows ({names}: p >= {number(least, 2)})"
        return (Message(Reason.LOOP_AS_DECLARED, said, {"p_value": least}),)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The words of the reasons."""
        return tuple(map(str, self.reasons))

    def _describe_open_law(self, finding: Finding) -> Message:
        """Return the message on another law that the record does not exclude."""
        assert finding.law is not None
        law, s = finding.law, finding.test
        clause = f"it may be that {law.words}, which this record does not exclude"
        share = f"{number(s.size, 2)} ± {number(2 * s.std, 2)}, where 0 is as declared and 1 is that"
        said = f"{clause} ({share}){self._describe_changes(finding, 'it would change')}"
        said += f"; see the drive's manual, or record a faster motion: if so, declare {law.remedy}"
        said += "; if it has the log's period, declare that" if law.rate else ""
        values = {"law": law.fault.name, "condition": law.words, **finding.values}
        return Message(Reason.LAW_UNDECIDED, said, values, clause)

    def _describe_changes(self, finding: Finding, before: str) -> str:
        far = sorted(finding.changes.items(), key=lambda item: -abs(item[1].sigmas))[:_LISTED]
        moved = [
            f"{self.symbols[name]} by {format_signed(change.by, 3)} {self.units[name]} ({abs(change.sigmas):.1f} sigma)"
            for name, change in far
            if abs(change.sigmas) >= _SMALLEST_SHIFT
        ]
        return f"; {before} {', '.join(moved)}" if moved else ""

    def _describe(self, finding: Finding) -> Message:
        s = finding.test
        p_value = "p < 1e-6" if s.p_value < 1e-6 else f"p = {number(s.p_value, 2)}"
        said, clause = f"{self._state(finding, spread=True)} ({p_value})", self._state(finding, spread=False)
        if s.alike:
            same = [one for one in s.alike if one not in s.opposite]
            also = f", or so is {_call(*same)}" if same else ""
            also += f", or {_call(*s.opposite)} is off by as much the other way" if s.opposite else ""
            said, clause = f"{said}{also}, which this loop cannot distinguish", clause + also
        if finding.rivals:
            rivals = (_call(rival.fault, *rival.alike) for rival in finding.rivals)
            said += f"; {' or '.join(rivals)} would explain nearly as much"
        said += self._describe_changes(finding, "correcting it changes") + self._name_laws(finding)
        values = {"suspect": s.name, "alike": [one.name for one in s.alike], **finding.values}
        return Message(s.fault.reason, said, values, clause)

    def _name_laws(self, finding: Finding) -> str:
        """Return the end of a sentence on the laws with the fault that was found or its rivals; "" without any."""
        fault, shape = finding.test.fault, finding.test.shape
        if fault.remedy:
            return "; " + fault.remedy.format(shape=number(shape, 3))
        named = (fault, *finding.test.alike, *(rival.fault for rival in finding.rivals))
        laws = dict.fromkeys(law for one in named if one.table == fault.table for law in one.laws if law in self.laws)
        if not laws:
            return ""
        tried = " or ".join(f'"{law}"' for law in laws)
        said = f"; to identify it, declare the joint with {fault.table} = {tried}"
        if self.of_loop:
            return f"{said}, as jointid diagnose --laws tells"
        speed = shape if StribeckFriction.name in laws else None
        return said if speed is None else f"{said} and stribeck_speed = {number(speed, 2)}"

    def _state(self, finding: Finding, *, spread: bool) -> str:
        """Return the clause that states a fault, its size and, with `spread`, its interval."""
        test, fault = finding.test, finding.test.fault
        if finding.law is not None:
            return self._state_laws(finding.law, finding)
        if not fault.says:
            return _state_number(test, spread=spread)
        side = "" if self.side is None else f" on the {self.side} side"
        units = {name: f"{self.units[name]}{side}" for name in ("torque", "position", "velocity")}
        size = _show_size(test, units, spread=spread)
        said = fault.says.format(
            size=size, by=f", by {size}" if size else "", of=f" of {size}" if size else "",
            shape="" if test.shape is None else number(test.shape, 2), value=number(finding.value or test.shape, 4),
            sense=fault.senses[test.size < 0], **units,
        )  # fmt: skip
        return " ".join(said.split())

    def _state_laws(self, law: OtherLaw, finding: Finding) -> str:
        """Return the clause on another law of the drive, and on equally good ones; rates of one law are joined.

        A law that is reported as undecided is not repeated. Rates that the record does not tell apart are equals: which
        of them leaves least is chance.
        """
        undecided = None if self.undecided is None else self.undecided.law
        of_each: dict[tuple[str, str | None], list[OtherLaw]] = {}
        for one in (law, *(other for other in finding.alike if other != undecided)):
            of_each.setdefault((one.fault.name, getattr(one.controller, "interpolation", None)), []).append(one)
        stated = []
        for first, *others in of_each.values():
            rates = "".join(f" or {1e-3 * one.rate:.4g} kHz" for one in others if one.rate)
            stated.append((first.words + rates, first.remedy))
        (said, remedy), *more = stated
        said = f"{said}: declare {remedy}"
        return said + "".join(f"; or {one}, which this record does not tell apart: {its}" for one, its in more)


def _call(*faults: Fault) -> str:
    return " or ".join(f"the {fault.title}" for fault in faults)


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
    name, share, deviation = _call(test.fault), test.size / abs(test.declared), 2 * test.std / abs(test.declared)
    if not -1 < share <= 1:
        return f"torque, reference, ratio or a gain is wrong by a factor, or has the wrong sign ({name} is the nearest)"
    way = "smaller" if share < 0 else "larger"
    if deviation >= abs(share):
        return f"{name} is {way} than declared, by how much this record does not tell"
    interval = f" ± {number(100 * deviation, 2)}" if spread else ""
    return f"{name} is {number(100 * abs(share), 2)}{interval} % {way} than declared"
