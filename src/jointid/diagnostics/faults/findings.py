"""Faults of one axis that were tested: those found, their sizes, what they change, and the sentences that state it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from jointid.common.messages import Message
from jointid.common.text import number
from jointid.common.transmission import Side
from jointid.diagnostics.faults.fault import Fault, FaultTest
from jointid.diagnostics.faults.words import state
from jointid.diagnostics.in_time import Part
from jointid.estimation.result.parts import format_signed
from jointid.estimation.result.verdict import Reason, Status
from jointid.models.controllers import Controller
from jointid.models.friction import FRICTIONS, StribeckFriction

_SMALLEST_SHIFT = 0.5  # of a deviation: a smaller change of a parameter is not listed
_LISTED = 3  # parameters in a sentence, at most


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
        excluded: where no fault was found, significant tests of faults that the motor position excludes.
        lacking: largest shift of each parameter, by name, by what looks like them and is in the joint.
        suspected: a fault of the mechanics beside those found that is significant at the level of those of the loop,
            not at its own tenth of that: it is not named, but intervals hold what it moves.
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
    excluded: tuple[FaultTest, ...] = ()
    lacking: Mapping[str, float] = field(default_factory=dict)
    suspected: Finding | None = None
    part: Part | None = None
    explained: float | None = None

    @property
    def as_declared(self) -> bool:
        """True if no fault was found."""
        return not self.findings and self.part is None

    @property
    def status(self) -> Status:
        """Passed where loop and log are as declared; unknown where another law would matter that is not excluded."""
        return Status.of(None if self.as_declared and self.undecided is not None else self.as_declared)

    @property
    def reasons(self) -> tuple[Message, ...]:
        """The faults found, one message each; one that says so where there are none."""
        if self.part is not None:
            return (self.part.reason,)
        if self.explained is not None:
            return (self._state_unknown_cause(self.explained),)
        undecided = () if self.undecided is None else (self._state_open_law(self.undecided),)
        if self.findings or undecided:
            return (*map(self._describe, self.findings), *undecided)
        least = min((s.p_value for s in self.tests), default=1.0)
        names = ", ".join(s.title for s in self.tests)
        said = f"loop and log are as declared as far as this record shows ({names}: p >= {number(least, 2)})"
        if self.excluded:
            alike = _call(*(one.fault for one in self.excluded))
            said += f"; a part of the residual looks like {alike} and is not: the motor position excludes that"
        return (Message(Reason.LOOP_AS_DECLARED, said, {"p_value": least}),)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The words of the reasons."""
        return tuple(map(str, self.reasons))

    @property
    def open_law(self) -> OtherLaw | None:
        """The law that is reported as undecided."""
        return None if self.undecided is None else self.undecided.law

    def on_side(self, quantity: str) -> str:
        """Return a quantity's unit with the side of the transmission."""
        return self.units[quantity] if self.side is None else f"{self.units[quantity]} on the {self.side} side"

    def _state_unknown_cause(self, explained: float) -> Message:
        """Return the message that something else is wrong, with the known faults that look like it."""
        clause = "something is wrong that is none of the known faults"
        alike = ", ".join(one.test.fault.phrase for one in self.findings)
        words = f"{clause}: {alike} together explain {number(100 * explained, 2)} % of the squares of the residual"
        return Message(Reason.NO_CAUSE_FOUND, words, {"explained": explained}, clause)

    def _state_open_law(self, finding: Finding) -> Message:
        """Return the message on another law that the record does not exclude."""
        assert finding.law is not None
        law, s = finding.law, finding.test
        clause = f"it may be that {law.words}, which this record does not exclude"
        share = f"{number(s.size, 2)} ± {number(2 * s.std, 2)}, where 0 is as declared and 1 is that"
        said = f"{clause} ({share}){self._describe_changes(finding, 'it would change')}"
        said += f"; see the drive's manual, or record a faster motion: if so, declare {law.remedy}"
        said += "; if it has the log's period, declare that" if law.rate else ""
        values = {"law": law.fault.name, "condition": law.words, "size": s.size, "std": s.std, "p_value": s.p_value}
        values |= {"changes": {name: change.by for name, change in finding.changes.items()}}
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
        said, clause = f"{state(finding, self, spread=True)} ({p_value})", state(finding, self, spread=False)
        if s.alike:
            same = [one for one in s.alike if one not in s.opposite]
            also = f", or so is {_call(*same)}" if same else ""
            also += f", or {_call(*s.opposite)} is off by as much the other way" if s.opposite else ""
            said, clause = f"{said}{also}, which this loop cannot distinguish", clause + also
        if finding.rivals:
            rivals = (_call(rival.fault, *rival.alike) for rival in finding.rivals)
            said += f"; {' or '.join(rivals)} would explain nearly as much"
        said += self._describe_changes(finding, "correcting it changes") + self._name_laws(finding)
        values = {"suspect": s.name, "alike": [one.name for one in s.alike], "more_than_declared": s.size}
        values |= {"std": s.std, "p_value": s.p_value}
        values |= {"changes": {name: change.by for name, change in finding.changes.items()}}
        return Message(s.fault.reason, said, values, clause)

    def list_laws_with(self, finding: Finding) -> tuple[str, ...]:
        """Return the laws that have a fault or its rivals."""
        fault = finding.test.fault
        named = (fault, *finding.test.alike, *(rival.fault for rival in finding.rivals))
        return (
            *dict.fromkeys(law for one in named if one.table == fault.table for law in one.laws if law in self.laws),
        )

    def _name_laws(self, finding: Finding) -> str:
        """Return the end of a sentence on the laws with the fault that was found; "" without any."""
        fault, table = finding.test.fault, finding.test.fault.table
        if fault.remedy:
            return "; " + fault.remedy.format(shape=number(finding.test.shape, 3))
        laws = self.list_laws_with(finding)
        if not laws:
            return ""
        # IDIM takes what is linear in its parameters on the measured motion.
        stepped = [] if self.of_loop else [law for law in laws if law in FRICTIONS and FRICTIONS[law]().stepped]
        tried = " or ".join(f'"{law}"{" (by didim)" if law in stepped else ""}' for law in laws)
        said = f"; to identify it, declare the joint with {table} = {tried}"
        if self.of_loop:
            return f"{said}, as jointid diagnose --laws tells"
        speed = finding.test.shape if StribeckFriction.name in laws else None
        return said if speed is None else f"{said} and stribeck_speed = {number(speed, 2)}"


def _call(*faults: Fault) -> str:
    return " or ".join(fault.phrase for fault in faults)
