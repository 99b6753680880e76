"""What the check of a loop has found: faults, their sizes, what they change, and the sentences that tell it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from jointid.common.document import Document, Documented, Listing, Table
from jointid.common.messages import Message
from jointid.common.text import number, signed
from jointid.common.transmission import Side
from jointid.diagnostics.fault_tests import INJECTED_GAIN, LIMIT, OFFSET, PRESLIDING, STRIBECK, FaultTest
from jointid.diagnostics.mechanics_faults import (
    BACKLASH,
    CHANGING_FRICTION,
    COGGING,
    COULOMB,
    CUBIC_SPRING,
    LOAD_DEPENDENT_FRICTION,
    MECHANICS,
    SECOND_MODE,
    WINDING_FRICTION,
)
from jointid.diagnostics.number_words import call, show_times_beside, tell_difference, tell_difference_in_drive
from jointid.diagnostics.other_laws import PERIOD, OtherLaw
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.friction import (
    AsymmetricStribeckFriction,
    DriftingFriction,
    LoadDependentFriction,
    PreslidingFriction,
    StribeckFriction,
)
from jointid.models.springs import Backlash, CubicSpring, ElasticLoad, ThreePieceSpring
from jointid.uncertainty.verdict import Reason, Status

_NAMES = {
    "log_gain": "the logged torque",
    INJECTED_GAIN: "the injected signal",
    CUBIC_SPRING: "a spring that is not linear",
    BACKLASH: "a backlash",
    LOAD_DEPENDENT_FRICTION: "a friction that grows with the load's torque",
    CHANGING_FRICTION: "a friction that changes over the record",
    WINDING_FRICTION: "a friction that winds up behind each reversal",
    SECOND_MODE: "a load that swings in itself",
    COGGING: "a force that comes back with the position",
}
_SMALLEST_SHIFT = 0.5  # of a deviation: a smaller change of a parameter is not listed
_MICROSECOND = 1e-6  # s: a shorter time is not said in ms
_LISTED = 3  # parameters in a sentence, at most
_RATIOS = ("log_gain", INJECTED_GAIN)
_SPRINGS = (CUBIC_SPRING, BACKLASH, SECOND_MODE)  # laws of which the joint file declares as springs
_AT_LOW_SPEED = (StribeckFriction.name, AsymmetricStribeckFriction.name)
_LAWS = {  # that have what a test found
    CUBIC_SPRING: (ThreePieceSpring.name, CubicSpring.name), BACKLASH: (Backlash.name,), STRIBECK: _AT_LOW_SPEED,
    PRESLIDING: (PreslidingFriction.name, *_AT_LOW_SPEED), LOAD_DEPENDENT_FRICTION: (LoadDependentFriction.name,),
    CHANGING_FRICTION: (DriftingFriction.name,), SECOND_MODE: (ElasticLoad.name,),
    WINDING_FRICTION: (PreslidingFriction.name,),
}  # fmt: skip


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
        law: that the drive runs instead of the declared one, where that is the fault.
        left: share of the filtered torque that is left under that law, or where the joint has that fault.
        alike: laws that explain as much as that one, the likeliest first.
    """

    test: FaultTest
    value: float | None
    rivals: tuple[str, ...]
    changes: Mapping[str, ParameterShift]
    law: OtherLaw | None = None
    left: float | None = None
    alike: tuple[OtherLaw, ...] = ()


@dataclass(frozen=True, slots=True)
class LoopCheck(Documented):
    """Faults of loop and log that were found, and the tests of all.

    Attributes:
        findings: faults found, the likeliest first.
        tests: of every fault as if it were the only one, the likeliest first.
        level: largest share of records without a fault in which one is found.
        symbols: of the joint's parameters, by name.
        units: of the joint's parameters by name, and of "torque" and "velocity".
        side: of the transmission, on which all of these numbers are; None without one.
        undecided: a law that the drive may run instead of the declared one, where the record excludes neither, and
            a parameter would move out of its interval.
        law: the controller's numbers as they are declared.
        shown: how the drive shows those that the joint file declares, by the law's names.
        laws: names of springs, and of frictions beyond lines, that the joint may have instead of its own.
    """

    findings: tuple[Finding, ...]
    tests: tuple[FaultTest, ...]
    level: float
    symbols: Mapping[str, str]
    units: Mapping[str, str]
    side: Side | None = None
    undecided: Finding | None = None
    law: Mapping[str, float] = field(default_factory=dict)
    shown: Mapping[str, DriveNumber] = field(default_factory=dict)
    laws: tuple[str, ...] = ()

    @property
    def as_declared(self) -> bool:
        """True if no fault was found."""
        return not self.findings

    @property
    def status(self) -> Status:
        """Passed where loop and log are as declared; unknown where another law would matter that is not excluded."""
        return Status.of(None if self.as_declared and self.undecided is not None else self.as_declared)

    @property
    def reasons(self) -> tuple[Message, ...]:
        """The faults found, one message each; one that says so where there are none."""
        undecided = () if self.undecided is None else (self._describe_undecided(self.undecided),)
        if self.findings or undecided:
            return (*map(self._describe, self.findings), *undecided)
        least = min((s.p_value for s in self.tests), default=1.0)
        names = ", ".join(s.label for s in self.tests)
        said = f"loop and log are as declared as far as this record shows ({names}: p >= {number(least, 2)})"
        return (Message(Reason.LOOP_AS_DECLARED, said, {"p_value": least}),)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The words of the reasons."""
        return tuple(map(str, self.reasons))

    def document(self, *, details: bool = False) -> Document:
        """Return the faults found, and the table of all tests; there are no further details."""
        del details
        return Document("Controller and log", (Listing(self.sentences), self.table()))

    def table(self, caption: str = "") -> Table:
        """Return the table of all tests, each as if nothing else were wrong."""
        rows = tuple(
            (s.label, f"{s.size:+.3g}", number(2 * s.std, 2), f"{s.statistic:+.1f}", number(s.p_value, 2))
            for s in self.tests
        )
        return Table(("fault", "more than declared", "2 sigma", "statistic", "p"), rows, caption)

    def _describe_undecided(self, finding: Finding) -> Message:
        """Return what another law would change that the record does not exclude."""
        assert finding.law is not None
        law, s = finding.law, finding.test
        share = f"{number(s.size, 2)} +- {number(2 * s.std, 2)}, where 0 is as declared and 1 is that"
        said = f"it may be that {law.words}, which this record does not exclude ({share})"
        said += self._describe_changes(finding, "it would change")
        said += f"; see the drive's manual, or record a faster motion: if so, declare {law.remedy}"
        said += "; if it has the log's period, declare that" if law.name == PERIOD else ""
        values = {"law": law.name, "condition": law.words, "size": s.size, "std": s.std, "p_value": s.p_value}
        values |= {"changes": {name: change.by for name, change in finding.changes.items()}}
        clause = f"it may be that {law.words}, which this record does not exclude"
        return Message(Reason.LAW_UNDECIDED, said, values, clause)

    @property
    def _open_law(self) -> OtherLaw | None:
        return None if self.undecided is None else self.undecided.law

    def _describe_changes(self, finding: Finding, before: str) -> str:
        far = sorted(finding.changes.items(), key=lambda item: -abs(item[1].sigmas))[:_LISTED]
        moved = [
            f"{self.symbols[name]} by {signed(change.by, 3)} {self.units[name]} ({abs(change.sigmas):.1f} sigma)"
            for name, change in far
            if abs(change.sigmas) >= _SMALLEST_SHIFT
        ]
        return f"; {before} {', '.join(moved)}" if moved else ""

    def _describe(self, finding: Finding) -> Message:
        s = finding.test
        p_value = "p < 1e-6" if s.p_value < 1e-6 else f"p = {number(s.p_value, 2)}"
        said = f"{self._describe_fault(finding)} ({p_value})"
        alike = " or ".join(map(self._called, s.alike))
        if s.alike:
            said += f", {self._also(s, alike)}, which this loop cannot distinguish from {self._called(s.name)}"
        if finding.rivals:
            said += f"; {' or '.join(map(self._called, finding.rivals))} would explain nearly as much"
        said += self._describe_changes(finding, "correcting it changes")
        said += self._say_what_to_declare(finding)
        values = {"suspect": s.name, "alike": list(s.alike), "more_than_declared": s.size, "std": s.std}
        values |= {"p_value": s.p_value, "changes": {name: change.by for name, change in finding.changes.items()}}
        clause = self._describe_fault(finding, spread=False)
        clause += f", {self._also(s, alike)}" if s.alike else ""
        code = Reason.FRICTION_NOT_AS_MODELLED if s.name in MECHANICS else Reason.LOOP_NOT_AS_DECLARED
        code = Reason.SPRING_NOT_LINEAR if s.name in (CUBIC_SPRING, BACKLASH) else code
        code = Reason.LOAD_NOT_RIGID if s.name == SECOND_MODE else code
        code = Reason.FORCE_FOLLOWS_POSITION if s.name == COGGING else code
        return Message(code, said, values, clause)

    def _say_what_to_declare(self, finding: Finding) -> str:
        """Return which law of spring or friction has what was found, as the end of a sentence; "" where none has."""
        test = finding.test
        if test.name == COGGING:
            return f"; to identify it, declare it: [ripple] period = {number(test.shape, 3)}"
        key = "spring" if test.name in _SPRINGS else "friction"
        if test.name not in _LAWS:
            return ""
        named = [n for n in (test.name, *test.alike, *finding.rivals) if (n in _SPRINGS) == (key == "spring")]
        laws = dict.fromkeys(law for name in named for law in _LAWS.get(name, ()) if law in self.laws)
        verb = "springs" if key == "spring" else "friction"
        tried = " or ".join(f'"{law}"' for law in laws)
        return f"; to identify it, set joint.{key} = {tried}, as jointid diagnose {verb} tells" if laws else ""

    def _describe_fault(self, finding: Finding, *, spread: bool = True) -> str:
        """Return a fault in words; `spread` says whether to give the interval of its size."""
        s, here = finding.test, "" if self.side is None else f" on the {self.side} side"
        torque = self.units["torque"] + here
        if finding.law is not None:
            # One that is told as undecided, with what it would change, is not told here, too.
            said = _describe_laws(finding.law, [one for one in finding.alike if one != self._open_law])
        elif s.name in ("delay", "log_delay"):
            unit, factor = ("ms", 1e3) if abs(s.size) >= _MICROSECOND else ("us", 1e6)
            sense = f"{_size(s, unit, spread=spread, factor=factor)}{'later' if s.size > 0 else 'earlier'}"
            than = "declared" if s.name == "delay" else "its time stamps say"
            what = "the torque reacts" if s.name == "delay" else "the logged torque is"
            said = f"{what} {sense} than {than}"
            if s.name == "delay" and s.size < 0 and s.declared <= 0.0:  # no torque comes before its command
                said += ", as where the controller runs faster than the log: declare its period"
        elif s.name == LIMIT:
            level = number(finding.value if finding.value is not None else s.shape, 4)
            said = f"the controller's output stops at {level} {torque}, which is not declared"
        elif s.name in (STRIBECK, PRESLIDING):
            speed = f"{number(s.shape, 2)} {self.units['velocity']}"
            sense = f"{_size(s, self.units['torque'], spread=spread)}{'larger' if s.name == STRIBECK else 'smaller'}"
            said = f"towards standstill, below some {speed}{here}, the friction is {sense} than Coulomb's"
        elif s.name in MECHANICS:
            said = _describe_mechanics(s, f"{self.units['velocity'].removesuffix('/s')}{here}", torque, spread=spread)
        elif s.name == OFFSET:
            sign = "-" if s.size < 0 else ""
            size = _size(s, torque, spread=spread)
            what = "torque" if self.units["velocity"].startswith("rad") else "force"
            said = f"a constant {what} {f'of {sign}{size}' if size else ''}is not declared"
        elif (there := self._in_drive(s.name)) is not None:
            said = tell_difference_in_drive(there, s, self.law, spread=spread)
            said += show_times_beside(s.name, s.declared + s.size, self.law, self.shown.values())
        else:
            scale = 1.0 if s.name in _RATIOS else abs(s.declared)
            said = tell_difference(self._called(s.name), s, scale, spread=spread)
        return said

    def _in_drive(self, name: str) -> DriveNumber | None:
        """Return how the drive shows a number, where the joint file declares it in a unit."""
        there = self.shown.get(name)
        return there if there is not None and there.unit and there.declared else None

    def _called(self, name: str) -> str:
        """Return a fault's name as a sentence has it, a number's as its drive has it; of several alike ones, too."""
        if " or " in name:
            return " or ".join(map(self._called, name.split(" or ")))
        there = self._in_drive(name)
        return _NAMES.get(name) or call(name if there is None else there.name)

    def _also(self, s: FaultTest, alike: str) -> str:
        """Return that another number may be off instead, by the share that the first one is off by."""
        return f"or so is {alike}" if self._in_drive(s.name) is None else f"or {alike} is off by as much"


def _describe_laws(law: OtherLaw, alike: Sequence[OtherLaw]) -> str:
    """Return that a drive runs another law, and which ones explain as much; rates of one law in a word each."""
    of_each: dict[str, list[OtherLaw]] = {}
    for one in (law, *alike):
        of_each.setdefault(one.name, []).append(one)
    told = []
    for first, *others in of_each.values():
        rates = ", ".join(f"{1e-3 * one.rate:.4g}" for one in others)
        told.append((f"{first.words} (or {rates} kHz)" if rates else first.words, first.remedy))
    (words, remedy), *more = told
    said = f"{words}: declare {remedy}"
    return said + "".join(f"; or {one}, which this record does not tell apart: {its}" for one, its in more)


def _describe_mechanics(s: FaultTest, unit: str, torque: str, *, spread: bool) -> str:
    """Return what the mechanics have and their model has not; "or more", as one step towards a large size is short."""
    percent, size = _size(s, "%", spread=spread, factor=100.0), _size(s, torque, spread=spread)
    sense = "stiffer" if s.size > 0 else "softer"
    more = f"{percent}or more " if percent else ""
    kind, way = "Coulomb" if s.shape == COULOMB else "viscous", "falls" if s.size > 0 else "rises"
    return {
        CUBIC_SPRING: f"the spring is not linear: {more}{sense} at the largest torque than near none",
        BACKLASH: f"the transmission has a backlash of some {number(2 * s.size * (s.shape or 0.0), 2)} {unit} or more",
        SECOND_MODE: f"a part of the load swings on a spring of its own, somewhere about {number(s.shape, 2)} Hz",
        LOAD_DEPENDENT_FRICTION: "the load's friction grows with its torque" + (f", by {percent}of it" * bool(percent)),
        WINDING_FRICTION: f"friction winds up behind each reversal, over some {number(s.shape, 2)} {unit}",
        CHANGING_FRICTION: f"the {kind} friction {way} over the record" + (f", by {percent.rstrip()}" * bool(percent)),
        COGGING: f"a force {f'of {size}' * bool(size)}comes back with the motor's position, every "
        f"{number(s.shape, 3)} {unit}",
    }[s.name]


def _size(s: FaultTest, unit: str, *, spread: bool, factor: float = 1.0) -> str:
    """Return the size of a fault and its interval, with a space behind; nothing where it may as well be 0.

    A test that is sure of a fault, and the size of it that is not, are of different problems: see `Finding`.
    """
    if 2 * s.std >= abs(s.size):
        return ""
    size = number(abs(factor * s.size), 3 if spread else 2)
    interval = f" +- {number(2 * factor * s.std, 2)}" if spread else ""
    return f"{size}{interval} {unit} "
