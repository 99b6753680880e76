"""Faults of one axis: what each is, its test, and those found, with the sentences that state them.

A fault is tested as a small deviation by its signatures. All that is particular to it is a field of `Fault`; the tests
and the report read these fields. What corrects a large one is in `changes`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.diagnostics.seen import Columns, Seen
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.parts import format_signed
from jointid.estimation.result.verdict import Reason
from jointid.models.controllers import Controller

_SMALLEST_SHIFT = 0.5  # of a deviation: a smaller change of a parameter is not listed
_LISTED = 3  # parameters in a sentence, at most
_NO_TIME = 1e-6  # s: no drive keeps so short a time

Measure: TypeAlias = Literal["", "%", "ms", "torque", "position", "level"]
"""Unit in which a sentence shows the size of a fault: none, or that its level is shown, as a torque."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault of the loop, the log or the mechanics: one row of one table, for joint and robot.

    Attributes:
        name: its code.
        title: noun phrase, without an article, that states it.
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
        measure: unit of its size.
        reason: code of the verdict.
        table: table of the joint file that declares a law with it.
        laws: names of these laws.
    """

    name: str
    title: str
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
    measure: Measure = ""
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
        p_value: adjusted for all tests of the record together.
        shape: the level of a limit in the torque's unit, or a Stribeck speed.
        axis: that has it.
    """

    in_json = "name statistic -fault -alike -axis"
    fault: Fault
    alike: tuple[Fault, ...]
    declared: float
    size: float
    std: float
    p_value: float
    shape: float | None = None
    axis: int = 0

    @property
    def name(self) -> str:
        """Code of the fault."""
        return self.fault.name

    @property
    def statistic(self) -> float:
        """Ratio of the size to its deviation."""
        return self.size / self.std if self.std > 0 else 0.0

    @property
    def strength(self) -> float:
        """The absolute statistic; at least 0 for a fault that can only be positive.

        A shape that is the best of many is strong by chance: the fault is as strong as a single test of its p-value.
        """
        from scipy.stats import norm

        found = max(self.statistic, 0.0) if self.fault.one_sided else abs(self.statistic)
        many = self.fault.tried > 1 and self.p_value > 0.0
        return min(found, float(norm.isf(0.5 * self.p_value))) if many else found


def name_number(name: str) -> str:
    """Return a number's name in words, also a filter's: "time constant of the velocity filter"."""
    *owner, last = name.replace("_", " ").split(".")
    if len(owner) == 2:  # one of several, which are counted
        return f"{last} of {owner[0].removesuffix('s')} {owner[1]}"
    return f"{last} of the {owner[0]}" if owner else last


def milliseconds(seconds: float) -> str:
    """Return a time in ms; one that no drive keeps is 0."""
    return "0" if abs(seconds) < _NO_TIME else number(1e3 * seconds, 2)


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
        evident: whether it is tried only where a record surely shows it.
    """

    fault: Fault
    words: str
    remedy: str
    controller: Controller
    rate: float = 0.0
    evident: bool = False


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


@dataclass(frozen=True, slots=True)
class Part:
    """Part of the time in which a residual is concentrated.

    Attributes:
        begin, end: of it, s.
        share: of the squares of the residual that are in it.
    """

    begin: float
    end: float
    share: float

    @property
    def reason(self) -> Message:
        """The message that states it."""
        clause = f"from {number(self.begin, 3)} to {number(self.end, 3)} s the torque does not follow the model"
        words = (
            f"{clause}: {number(100 * self.share, 2)} % of the squares of the residual are there, and no known fault "
            "explains them, as where something touches the joint; leave that out by record.start and record.stop "
            "(times count from the first sample that was read)"
        )
        values = {"begin": self.begin, "end": self.end, "share": self.share}
        return Message(Reason.MISFIT_IN_PART, words, values, clause)


@dataclass(frozen=True, slots=True)
class AxisFaults:
    """Faults of one axis that were found, and the tests of all.

    Attributes:
        findings: faults found, the likeliest first.
        tests: of every fault as if it were the only one, the likeliest first.
        symbols: of the joint's parameters, by name.
        units: of the joint's parameters by name, and of "torque", "position" and "velocity".
        laws: names of springs and nonlinear frictions that can replace those of the joint.
        of_loop: whether faults of the loop were tested, which needs its simulation.
        suspected: faults that are not named, and whose shifts the intervals hold. One of the mechanics that is
            significant at the level of those of the loop, not at its own tenth of that; where none was found, one of
            loop or log that the motor position excludes: the joint has what looks like it; and another law that the
            record does not exclude, and that would shift a parameter out of its interval.
        part: of the time in which the residual is concentrated, faults corrected; no fault is named beside it.
        explained: share of the squares of the residual that the faults explain together, where so many were found that
            none of them is likely to be the cause.
    """

    findings: tuple[Finding, ...]
    tests: tuple[FaultTest, ...]
    symbols: Mapping[str, str]
    units: Mapping[str, str]
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
    def reasons(self) -> tuple[Message, ...]:
        """The faults found, one message each; one that says so where there are none."""
        if self.part is not None:
            return (self.part.reason,)
        if self.explained is not None:
            clause = "something is wrong that is none of the known faults"
            share, alike = number(100 * self.explained, 2), ", ".join(_call(one.test.fault) for one in self.findings)
            words = f"{clause}: {alike} together explain {share} % of the squares of the residual"
            return (Message(Reason.NO_CAUSE_FOUND, words, {"explained": self.explained}, clause),)
        if self.findings:
            return tuple(map(self._describe, self.findings))
        least = min((one.p_value for one in self.tests), default=1.0)
        said = f"loop and log are as declared as far as this record shows ({len(self.tests)} faults were tested, "
        said += f"p >= {number(least, 2)})"
        return (Message(Reason.LOOP_AS_DECLARED, said, {"p_value": least}),)

    def _describe(self, finding: Finding) -> Message:
        """Return the message on a fault: its size, what else may be, what it moves, and what to declare."""
        test = finding.test
        clause = self._state(finding)
        if test.alike:
            clause += f", or {_call(*test.alike)} is wrong, which this loop cannot distinguish"
        words = f"{clause} ({'p < 1e-6' if test.p_value < 1e-6 else f'p = {number(test.p_value, 2)}'})"
        if finding.rivals:
            words += f"; {_call(*(rival.fault for rival in finding.rivals))} would explain nearly as much"
        words += self._describe_changes(finding) + self._name_laws(test.fault, test.shape)
        changes = {name: change.by for name, change in finding.changes.items()}
        numbers = {"size": test.size, "std": test.std, "p_value": test.p_value, "changes": changes}
        values = {"suspect": test.name, "alike": [one.name for one in test.alike], **numbers}
        return Message(test.fault.reason, words, values, clause)

    def _describe_changes(self, finding: Finding) -> str:
        """Return the part of a sentence on the parameters that a correction moves, the farthest first."""
        far = sorted(finding.changes.items(), key=lambda item: -abs(item[1].sigmas))[:_LISTED]
        moved = [
            f"{self.symbols[name]} by {format_signed(change.by, 3)} {self.units[name]} ({abs(change.sigmas):.1f} sigma)"
            for name, change in far
            if abs(change.sigmas) >= _SMALLEST_SHIFT
        ]
        return f"; correcting it changes {', '.join(moved)}" if moved else ""

    def _name_laws(self, fault: Fault, shape: float | None) -> str:
        """Return the end of a sentence on what else to declare; "" without any."""
        laws = [f'"{law}"' for law in fault.laws if law in self.laws]
        if fault.remedy or not laws:
            return fault.remedy and "; " + fault.remedy.format(shape=number(shape, 3))
        said = f"; to identify it, declare the joint with {fault.table} = {' or '.join(laws)}"
        by_hand = not self.of_loop and "stribeck" in fault.laws
        return f"{said} and stribeck_speed = {number(shape, 2)}" if by_hand else said

    def _state(self, finding: Finding) -> str:
        """Return the clause that states a fault with its size and interval, or the laws that the drive may run."""
        test, fault = finding.test, finding.test.fault
        if finding.law is not None:
            laws = [f"{one.words}: declare {one.remedy}" for one in (finding.law, *finding.alike)]
            return "; or, as far as this record shows, ".join(laws)
        if test.declared and not fault.measure:
            return _state_number(test)
        unit, factor = {"ms": ("ms", 1e3), "%": ("%", 100.0)}.get(fault.measure, ("", 1.0))
        unit = unit or self.units.get(fault.measure, "")
        size = f"{format_signed(factor * test.size, 3)} ± {number(2 * factor * test.std, 2)} {unit}"
        if fault.measure == "level":
            size = f"{number(finding.value or test.shape, 4)} {self.units['torque']}"
        return fault.title if not fault.measure or 2 * test.std >= abs(test.size) else f"{fault.title}: {size}"


def _call(*faults: Fault) -> str:
    return " or ".join(f"the {fault.title}" for fault in faults)


def _state_number(test: FaultTest) -> str:
    """Return the clause on the difference of a number from its declaration, in percent of that.

    A sensitivity is no guide to a change as large as the number itself.
    """
    name, share, deviation = _call(test.fault), test.size / abs(test.declared), 2 * test.std / abs(test.declared)
    if not -1 < share <= 1:
        return f"torque, reference, ratio or a gain is wrong by a factor, or has the wrong sign ({name} is the nearest)"
    size = f"{number(100 * abs(share), 2)} ± {number(100 * deviation, 2)} %"
    return f"{name} is {size} {'smaller' if share < 0 else 'larger'} than declared"
