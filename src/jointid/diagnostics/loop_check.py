"""Result of a loop check: the test of every fault, and the faults found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from jointid.common.document import Document, Documented, Listing, Table
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.common.transmission import Side
from jointid.diagnostics.fault_signatures import INJECTED_GAIN, LIMIT, OFFSET, PRESLIDING, STRIBECK
from jointid.uncertainty.verdict import Reason

_SMALLEST_SHIFT = 0.5  # of a deviation: a smaller change of a parameter is not listed
_LISTED = 3  # parameters in a sentence, at most
_RATIOS = ("log_gain", INJECTED_GAIN)


@dataclass(frozen=True, slots=True)
class FaultTest:
    """Test of one fault.

    Attributes:
        name: "kp", "delay", "log_gain", ...: see `fault_signatures`.
        alike: faults that no record of this loop can distinguish from it.
        declared: value; 0 for what is not declared at all.
        size: value less the declared one; of a limit, the observed share of what it cuts off.
        std: standard deviation of the size, autocorrelation-robust.
        statistic: their ratio.
        p_value: adjusted for all tests of the record together.
        shape: the level of a limit in the torque's unit, or a Stribeck speed.
    """

    name: str
    alike: tuple[str, ...]
    declared: float
    size: float
    std: float
    statistic: float
    p_value: float
    shape: float | None = None

    @property
    def label(self) -> str:
        """Its name, and those of the faults it cannot be distinguished from."""
        return " or ".join((self.name, *self.alike))


@dataclass(frozen=True, slots=True)
class ParameterShift:
    """Change of a parameter when a fault is corrected: in its unit, and in its standard deviations."""

    by: float
    sigmas: float


@dataclass(frozen=True, slots=True)
class Finding:
    """Fault of loop or log.

    Attributes:
        test: of the fault, those found before it corrected.
        value: estimated, in the unit of the declaration; None where no parameter stands for the fault.
        rivals: faults that are at most 20 times less likely.
        changes: of the joint's parameters, by name, when it is corrected.
    """

    test: FaultTest
    value: float | None
    rivals: tuple[str, ...]
    changes: Mapping[str, ParameterShift]


@dataclass(frozen=True, slots=True)
class LoopCheck(Documented):
    """Whether the loop and the log are as declared.

    Attributes:
        findings: faults found, the likeliest first.
        tests: of every fault as if it were the only one, the likeliest first.
        level: largest share of records without a fault in which one is found.
        symbols: of the joint's parameters, by name.
        units: of the joint's parameters by name, and of "torque" and "velocity".
        side: of the transmission, on which all of these numbers are; None without one.
    """

    findings: tuple[Finding, ...]
    tests: tuple[FaultTest, ...]
    level: float
    symbols: Mapping[str, str]
    units: Mapping[str, str]
    side: Side | None = None

    @property
    def as_declared(self) -> bool:
        """True if no fault was found."""
        return not self.findings

    @property
    def reasons(self) -> tuple[Message, ...]:
        """What was found, one message each; one that says so where nothing was."""
        if self.findings:
            return tuple(Message(Reason.LOOP_NOT_AS_DECLARED, self._describe(f), _values(f)) for f in self.findings)
        least = min((s.p_value for s in self.tests), default=1.0)
        names = ", ".join(s.label for s in self.tests)
        said = f"loop and log are as declared as far as this record shows ({names}: p >= {number(least, 2)})"
        return (Message(Reason.LOOP_AS_DECLARED, said, {"p_value": least}),)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The words of the reasons."""
        return tuple(map(str, self.reasons))

    def document(self, *, details: bool = False) -> Document:
        """Return what was found, and the table of all tests; there are no further details."""
        del details
        return Document("Controller and log", (Listing(self.sentences), self.table()))

    def table(self, caption: str = "") -> Table:
        """Return the table of all tests, each as if nothing else were wrong."""
        return Table(
            ("fault", "more than declared", "2 sigma", "statistic", "p"), tuple(map(_format_row, self.tests)), caption
        )

    def _describe(self, finding: Finding) -> str:
        s = finding.test
        said = f"{self._describe_fault(finding)} ({_format_p(s.p_value)})"
        if s.alike:
            said += f", or so is {' or '.join(s.alike)}, which this loop cannot distinguish from {s.name}"
        if finding.rivals:
            said += f"; {' or '.join(finding.rivals)} would explain nearly as much"
        far = sorted(finding.changes.items(), key=lambda item: -abs(item[1].sigmas))[:_LISTED]
        moved = [
            f"{self.symbols[name]} by {change.by:+.3g} {self.units[name]} ({abs(change.sigmas):.1f} sigma)"
            for name, change in far
            if abs(change.sigmas) >= _SMALLEST_SHIFT
        ]
        return f"{said}; correcting it changes {', '.join(moved)}" if moved else said

    def _describe_fault(self, finding: Finding) -> str:
        """Return a fault in words."""
        s, here = finding.test, "" if self.side is None else f" on the {self.side} side"
        torque = self.units["torque"] + here
        interval = f"{number(abs(s.size), 3)} +- {number(2 * s.std, 2)}"
        if s.name in ("delay", "log_delay"):
            sense = "later" if s.size > 0 else "earlier"
            late = f"{number(1e3 * abs(s.size), 3)} +- {number(2e3 * s.std, 2)} ms {sense} than"
            return (
                f"the torque reacts {late} declared"
                if s.name == "delay"
                else f"the logged torque is {late} its time stamps say"
            )
        if s.name == LIMIT:
            level = number(finding.value if finding.value is not None else s.shape, 4)
            return f"the controller's output stops at {level} {torque}, which is not declared"
        if s.name in (STRIBECK, PRESLIDING):
            speed = f"{number(s.shape, 2)} {self.units['velocity']}"
            sense = "larger" if s.name == STRIBECK else "smaller"
            slow = f"towards standstill, below some {speed}{here}"
            return f"{slow}, the friction is {interval} {self.units['torque']} {sense} than Coulomb's"
        if s.name == OFFSET:
            return f"a constant force of {number(s.size, 3)} +- {number(2 * s.std, 2)} {torque} is not declared"
        scale = 1.0 if s.name in _RATIOS else abs(s.declared)
        percent = f"{number(100 * abs(s.size) / scale, 2)} +- {number(200 * s.std / scale, 2)} %"
        what = {"log_gain": "the logged torque", INJECTED_GAIN: "the injected signal"}.get(s.name, s.name)
        return f"{what} is {percent} {'larger' if s.size > 0 else 'smaller'} than declared"


def _values(finding: Finding) -> dict[str, object]:
    s = finding.test
    return {"suspect": s.name, "alike": list(s.alike), "more_than_declared": s.size, "std": s.std, "p_value": s.p_value}


def _format_row(s: FaultTest) -> tuple[str, ...]:
    return s.label, f"{s.size:+.3g}", number(2 * s.std, 2), f"{s.statistic:+.1f}", number(s.p_value, 2)


def _format_p(p_value: float) -> str:
    return "p < 1e-6" if p_value < 1e-6 else f"p = {number(p_value, 2)}"
