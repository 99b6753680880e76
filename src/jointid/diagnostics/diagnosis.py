"""Diagnosis of a record: what is wrong with it, with its loop and with its joint, axis by axis.

First stand its symptoms, in the order in which one spoils the next. Then, of each axis: the part of its torque that the
estimate leaves, and whether that is noise; the controller's torque along the logged motor position; and the faults that
were tested. The controller is compared without a model of the axis, so its faults are distinguished from those of the
model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from jointid.common.document import Block, Document, Documented, Facts, Heading, Listing, Paragraph, Table
from jointid.common.messages import Message
from jointid.common.text import join, number, sentence
from jointid.common.transmission import Transmission
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.faults.findings import AxisFaults
from jointid.diagnostics.law_comparison import LawComparison
from jointid.diagnostics.model_free import Agreement, LawOnPosition
from jointid.diagnostics.robot_causes import RobotCause
from jointid.estimation.result.verdict import Reason
from jointid.uncertainty.residual_tests import Whiteness

_LEFT = 0.03  # of a torque: what is left, if it is not white, is worth a sentence
_SURE = 0.001  # of white noise that is taken for coloured: rare in all axes of a robot together
_MOST_TESTS = 20  # rows of a table


DIFFERS = "joint_differs"
_VAGUE = (Agreement.DIFFERS, DIFFERS, str(Reason.NO_CAUSE_FOUND))
"""Symptoms of unknown cause."""


@dataclass(frozen=True, slots=True)
class Symptom:
    """One thing that is wrong with a record or its estimate, or cannot be told.

    Attributes:
        code: of it; a cause that was found has its own.
        said: clause with its numbers and its remedy.
        axis: name of the joint of a robot; "" of a joint alone, and of all joints.
        spoils: whether an estimate with it is not relied on.
    """

    code: str
    said: str
    axis: str = ""
    spoils: bool = True

    def __str__(self) -> str:
        return f"{self.axis and f'{self.axis}: '}{self.said}"


@dataclass(frozen=True, slots=True, eq=False)
class AxisDiagnosis:
    """Diagnosis of one axis.

    Attributes:
        name: of the joint; empty of a joint alone.
        left: share of its filtered torque that the estimate leaves.
        whiteness: of what is left; None where the record is too short.
        law: what the declared controller leaves of the logged torque; None without a controller, a reference or a
            logged motor position.
        faults: that were tested, and those found.
        repeats: whether what is left repeats with the axis' motion; None where that was not tested.
        caused: whether a cause explains what is left that is none of this axis alone.
    """

    in_json = "explained as_declared law_holds"
    name: str
    left: float
    whiteness: Whiteness | None
    law: LawOnPosition | None
    faults: AxisFaults
    repeats: bool | None = None
    caused: bool = False

    @property
    def explained(self) -> bool:
        """True if what is left is small, or nothing but noise as far as is seen."""
        if self.left < _LEFT or self.whiteness is None or self.whiteness.white:
            return True
        return self.whiteness.p_value > _SURE or (self.repeats is False and not self.faults.findings)

    @property
    def coloured(self) -> bool:
        """True if what is left is little, or does not repeat with the motion, but surely no white noise."""
        return self.explained and self.whiteness is not None and self.whiteness.p_value <= _SURE

    @property
    def is_small(self) -> bool:
        """True if what is left is little, and is not surely coloured."""
        return self.left < _LEFT and not self.coloured

    @property
    def law_holds(self) -> bool | None:
        """Whether the declared controller makes the logged torque; None where that is not seen."""
        return None if self.law is None else self.law.holds

    @property
    def as_declared(self) -> bool | None:
        """False if loop or log has a fault, or the controller does not hold; None if neither was tested."""
        counts = (one for one in self.faults.findings if self.faults.of_loop or not one.test.fault.of_model)
        if any(counts) or self.law_holds is False or self.faults.part is not None:
            return False
        return True if self.law_holds or self.faults.of_loop else None

    @property
    def subject(self) -> str:
        """Begin of a sentence on the axis; empty of a joint alone."""
        return f"{self.name}: " if self.name else ""

    @property
    def sentences(self) -> tuple[str, ...]:
        """Faults of the axis, each with its remedy, begun with the axis' name."""
        found = list[str]()
        if self.faults.findings or self.faults.undecided is not None or self.faults.part is not None:
            found += self.faults.sentences
        elif not self.caused:
            found.append(self._describe_rest())
        return tuple(f"{self.subject}{sentence(one)}" for one in found if one)

    def _describe_rest(self) -> str:
        """Return what is left that is no white noise; "" where it is."""
        if self.explained and not self.coloured:
            return ""
        said = f"the model leaves {100 * self.left:.3g} % of the torque, and that is no white noise"
        if not self.explained:
            return (
                f"{said}. None of the faults explains it: check geometry, gears and couplings of the model, and do not "
                "rely on this joint's intervals"
            )
        return said if self.left < _LEFT else f"{said}, but it does not repeat with the motion, like coloured noise"


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis(Documented):
    """Diagnosis of a record, and of the estimate from it.

    Attributes:
        name: of the record of a joint, or of the robot.
        method: of the estimate; empty where nothing could be identified.
        axes: the diagnosis of each: one of a joint; none where nothing could be identified.
        torques: of the record, beside the estimate's.
        cause: of the whole log or model, that explains more than the faults of single axes.
        symptoms: of the record and its estimate, the first first; none in the diagnosis that an estimate has.
        logged: the channels of the record, in a sentence; empty where it was not examined.
        laws: comparisons of the laws of springs and frictions, where they were asked for.
        transmission: on whose `side` all numbers are.
    """

    in_json = "healthy explained as_declared sentence sentences -torques"
    name: str
    method: str = ""
    axes: tuple[AxisDiagnosis, ...] = ()
    torques: AxisTorques | None = None
    cause: RobotCause | None = None
    symptoms: tuple[Symptom, ...] = ()
    logged: str = ""
    laws: tuple[LawComparison, ...] = ()
    transmission: Transmission | None = None

    @property
    def healthy(self) -> bool:
        """True if no symptom spoils the answer; a parameter that is not identifiable is none."""
        return not any(one.spoils for one in self.symptoms)

    @property
    def explained(self) -> bool:
        """True if no axis' torque has a part that the model should have explained."""
        return self.cause is None and all(one.explained for one in self.axes)

    @property
    def as_declared(self) -> bool | None:
        """True if all loops and logs are as declared, False if one is not; None if one cannot be tested."""
        seen = [one.as_declared for one in self.axes]
        return False if False in seen else None if None in seen else True

    @property
    def finds_nothing(self) -> bool:
        """True if record, loop, log and joint have no fault, and nothing of the torque is left unexplained."""
        faulty = any(axis.faults.findings for axis in self.axes) or self.parts
        return self.healthy and self.explained and self.as_declared is not False and not faulty

    def name_faults(self, *, of_model: bool) -> tuple[Message, ...]:
        """Return the faults found of models, or of loops and logs, each with its axis."""
        return tuple(
            _of_axis(axis, reason)
            for axis in self.axes
            for finding, reason in zip(axis.faults.findings, axis.faults.reasons, strict=False)
            if finding.test.fault.of_model is of_model
        )

    @property
    def parts(self) -> tuple[Message, ...]:
        """Return the parts of the time in which axes do not follow the model."""
        return tuple(_of_axis(axis, axis.faults.part.reason) for axis in self.axes if axis.faults.part is not None)

    @property
    def undecided(self) -> tuple[Message, ...]:
        """Other controller laws that matter and are not excluded, by axis."""
        open_ones = [axis for axis in self.axes if axis.faults.undecided is not None]
        return tuple(_of_axis(axis, axis.faults.reasons[-1]) for axis in open_ones)

    @property
    def untested(self) -> tuple[str, ...]:
        """Names of the axes whose controllers cannot be tested, if others can."""
        found = tuple(one.name for one in self.axes if one.law_holds is None)
        return found if len(found) < len(self.axes) else ()

    def describe_laws(self, holds: bool | None) -> str:
        """Return the clause on the controllers that make the logged torques, do not, or (None) cannot be tested."""
        names = [one.name for one in self.axes if one.law_holds is holds]
        if not names or (holds is None and not self.untested):
            return ""
        of = f" of {join(names)}" if any(names) else ""
        which = f"the {'declared ' * (holds is not None)}controller{of}"
        if holds is None:
            return f"{which} was not checked, which needs a declared controller, a motor position and a reference"
        return f"{which} {'makes' if holds else 'does not make'} the logged torque of the logged position"

    @property
    def sentences(self) -> tuple[str, ...]:
        """Faults of all axes, each with its remedy."""
        found = []
        if self.cause is not None:
            found += [
                sentence(str(self.cause)),
                "Correct this first, and identify again: other faults of single joints are named only then.",
            ]
        found += [sentence(wrong)] if (wrong := self.describe_laws(holds=False)) else []
        found += [one for axis in self.axes for one in axis.sentences]
        return tuple(found)

    @property
    def sentence(self) -> str:
        """The first fault in a sentence."""
        first = sorted(self.symptoms, key=lambda one: (not one.spoils, one.code in _VAGUE))[:1]
        if first and first[0].spoils:
            return f"{self.name}: {first[0]}."
        if self.logged:
            none = f"Nothing is wrong with {'' if self.axes else 'the record '}{self.name}."
            return f"Nothing that is wrong with {self.name} spoils its answer: {first[0]}." if first else none
        if not self.finds_nothing:
            return self.sentences[0]
        left = 100 * max(one.left for one in self.axes)
        return f"The model leaves {left:.2g} % of the torque at most, and nothing is found that is not as declared."

    def to_document(self, *, details: bool = False) -> Document:
        """Return the symptoms, a table of the axes, what to do, and the comparisons of laws.

        Args:
            details: whether all tests are listed.
        """
        blocks: list[Block] = [Paragraph(self.logged)] if self.logged else []
        blocks += (
            [Heading("What is wrong"), Listing(tuple(sentence(str(one)) for one in self.symptoms))]
            if self.symptoms[1:]
            else []
        )
        if self.transmission is not None:
            blocks.append(Facts((("transmission", str(self.transmission)),)))
        if self.axes:
            blocks.append(self._table())
            blocks += [Heading("What to do"), Listing(self.sentences)] if self.sentences else []
            blocks += self._tests(details)
        for part in (one.to_document() for one in self.laws):
            blocks += [Heading(part.title), *part.blocks]
        return Document(self.sentence, tuple(blocks))

    def _table(self) -> Table:
        """Return what the model, and the controller by the logged position, leave of each axis' torque."""
        header = ("joint", "left, %", "white", "controller leaves, %", "any law, %")
        rows = []
        for one in self.axes:
            white = "-" if one.whiteness is None else "yes" if one.whiteness.white else "no"
            law = ("-", "-") if one.law is None else (f"{100 * one.law.left:.3g}", f"{100 * one.law.noise:.2g}")
            rows.append((one.name or "joint", f"{100 * one.left:.3g}", white, *law))
        return Table(header, tuple(rows), "residual of each joint's filtered torque", (0, 2))

    def _tests(self, details: bool) -> tuple[Table, ...]:
        """Return the table of the tests, or of the significant ones where there are many."""
        tests = [(one, test) for one in self.axes for test in one.faults.tests]
        if not details and len(tests) > _MOST_TESTS:
            tests = [(one, test) for one, test in tests if test.p_value <= one.faults.level]
        rows = tuple(
            (
                one.name or "joint", s.label, f"{s.size:+.3g}", number(2 * s.std, 2), f"{s.statistic:+.1f}",
                number(s.p_value, 2),
            )
            for one, s in tests
        )  # fmt: skip
        header = ("joint", "fault", "more than declared", "2 sigma", "statistic", "p")
        return (Table(header, rows, "faults, each as if nothing else were wrong", (0, 1)),) if rows else ()


def _of_axis(axis: AxisDiagnosis, reason: Message) -> Message:
    return replace(reason, words=f"{axis.subject}{reason}", clause=f"{axis.subject}{reason.brief}")
