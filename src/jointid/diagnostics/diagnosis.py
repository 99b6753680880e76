"""Diagnosis of an estimate, axis by axis: what its record determines, and whether its loops and models are as declared.

Of each axis: the part of its torque that the estimate leaves, whether that is noise, and what it correlates with; the
parameters that the record tells; the controller's torque along the logged motor position; and the faults that were
tested. The controller is compared without a model of the axis, so its faults are distinguished from those of the model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from jointid.common.document import Block, Document, Documented, Facts, Heading, Listing, Paragraph, Table
from jointid.common.messages import Message
from jointid.common.text import join, number, pluralise, sentence
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.faults.findings import AxisFaults
from jointid.diagnostics.model_free import BEYOND_NOISE, OF_LAW, LawOnPosition
from jointid.diagnostics.robot_causes import RobotCause
from jointid.estimation.result.parts import EstimatedParameter
from jointid.estimation.result.robot import KNOWN
from jointid.uncertainty.residual_tests import Coupling, Whiteness

_LEFT = 0.03  # of a torque: what is left, if it is not white, is worth a sentence
_SURE = 0.001  # of white noise that is taken for coloured: rare in all axes of a robot together
_MUCH = 0.25  # of what is left, that follows one thing
_OF_ANY_LAW = 0.1  # of a torque, that any law leaves: no law alone makes the torque
_RESTS = 0.5  # of the record, moving
_ROUGHLY = 0.5  # relative deviation, from which the interval of two holds 0
_MOST_NAMES = 8
_MOST_TESTS = 20  # rows of a table


class Told(StrEnum):
    """How well a record tells a parameter."""

    TOLD = "told"
    ROUGHLY = "roughly"
    NOT = "not significant"
    REFUSED = "refused"
    FIXED = "fixed"


def tell(row: EstimatedParameter) -> Told:
    """Return how well a parameter is told: by a deviation below a tenth of it, or below half."""
    if not row.free:
        return Told.FIXED
    if row.value is None or row.stderr is None:
        return Told.REFUSED
    share = row.stderr / abs(row.value) if row.value else math.inf
    return Told.TOLD if share < KNOWN else Told.ROUGHLY if share < _ROUGHLY else Told.NOT


@dataclass(frozen=True, slots=True, eq=False)
class AxisDiagnosis:
    """Diagnosis of one axis.

    Attributes:
        name: of the joint; empty of a joint alone.
        left: share of its filtered torque that the estimate leaves.
        whiteness: of what is left; None where the record is too short.
        follows: what that follows most, and the share of it that does; None where nothing exceeds chance.
        moving: share of the rows in which it moves.
        position_unit, torque_unit: rad or m; of its torque.
        parameters: of it.
        law: what the declared controller leaves of the logged torque; None without a controller, a reference or a
            logged motor position.
        faults: that were tested, and those found.
        repeats: whether what is left repeats with the axis' motion; None where that was not tested.
        caused: whether a cause explains what is left that is none of this axis alone.
    """

    in_json = "explained as_declared law_holds -parameters"
    name: str
    left: float
    whiteness: Whiteness | None
    follows: tuple[str, Coupling] | None
    moving: float
    position_unit: str
    torque_unit: str
    parameters: tuple[EstimatedParameter, ...]
    law: LawOnPosition | None
    faults: AxisFaults
    repeats: bool | None = None
    caused: bool = False

    @property
    def asked(self) -> tuple[EstimatedParameter, ...]:
        """Its parameters without the fixed ones."""
        return tuple(one for one in self.parameters if one.free)

    def names(self, *known: Told) -> tuple[str, ...]:
        """Return the names of the parameters that are known so."""
        return tuple(one.name for one in self.parameters if tell(one) in known)

    @property
    def explained(self) -> bool:
        """True if what is left is small, or nothing but noise as far as is seen; see `judged`."""
        if self.left < _LEFT or self.whiteness is None or self.whiteness.white:
            return True
        return (self.whiteness.p_value > _SURE or self._is_coloured_noise) and not self._one_thing

    @property
    def _is_coloured_noise(self) -> bool:
        return self.repeats is False and not self.faults.findings

    @property
    def judged(self) -> bool:
        """False if the residual is large and the record too short to tell noise from a fault of the model."""
        return self.left < _LEFT or self.whiteness is not None

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
        if any(counts) or self.law_holds is False:
            return False
        return True if self.law_holds or self.faults.of_loop else None

    @property
    def subject(self) -> str:
        """Begin of a sentence on the axis; empty of a joint alone."""
        return f"{self.name}: " if self.name else ""

    @property
    def _one_thing(self) -> bool:
        return self.follows is not None and self.follows[1].explained > _MUCH

    @property
    def sentences(self) -> tuple[str, ...]:
        """Faults of the axis, each with its remedy, begun with the axis' name."""
        found = [self._describe_law(), self._describe_rest()]
        if self.faults.findings or self.faults.undecided is not None:
            found += self.faults.sentences
        elif self.caused:
            pass
        elif not self.explained:
            found.append(self._describe_unexplained_part())
        elif self.coloured:
            follows = f"; it follows {self.follows[0]}" if self.follows is not None and self._one_thing else ""
            left = f"the model leaves {100 * self.left:.3g} % of the torque, which is"
            found.append(
                f"{left} little, but no white noise{follows}."
                if self.left < _LEFT
                else f"{left} no white noise, but does not repeat with the motion, like coloured noise of the log."
            )
        found += [
            f"the spring is refused, at least {number(one.lower_bound, 3)} {one.unit}; declare the joint rigid, or "
            "excite its mode, as with a multisine on top of the motion."
            for one in self.parameters
            if tell(one) is Told.REFUSED and one.lower_bound is not None
        ]
        return tuple(f"{self.subject}{sentence(one)}" for one in found if one)

    def _describe_rest(self) -> str:
        if self.moving >= _RESTS:
            return ""
        return (
            f"the axis moves in {100 * self.moving:.0f} % of the record; its friction and inertia are "
            "determined only while it moves: let it move throughout."
        )

    def _describe_unexplained_part(self) -> str:
        said = f"the model leaves {100 * self.left:.3g} % of the torque, and that is no noise"
        if self.follows is None or not self._one_thing:
            return (
                f"{said}. It follows none of the tested signals: check geometry, gears and couplings of the "
                "model, and do not rely on this joint's intervals."
            )
        what, share = self.follows
        return (
            f"{said}: {100 * share.explained:.0f} % of it follows {what} (by chance at most "
            f"{100 * share.by_chance:.0f} %). Model that, or take the parameters with as much doubt."
        )

    def _describe_law(self) -> str:
        """Return that the controller does not make the torque, with the one number that corrects it if there is one."""
        law = self.law
        if law is None or self.law_holds:
            return ""
        said = f"along the logged position the declared controller leaves {100 * law.left:.3g} % of the torque"
        if law.left_in_time <= BEYOND_NOISE * max(law.noise, OF_LAW) and law.noise < _OF_ANY_LAW:
            if not law.late:
                return f"{said}, which is {law.gain:.3g} times the law's: correct torque_constant, ratio or gains."
            when = f"{1e3 * abs(law.late):.3g} ms {'later' if law.late > 0.0 else 'earlier'}"
            return (
                f"{said}; what fits best acts {when} than declared: correct delay or time stamps, "
                "or the gains, which may look like that."
            )
        return (
            f"{said}, any linear law of the last samples {100 * law.noise:.2g} %, and the model {100 * self.left:.2g} "
            "%. The drive runs another law, or something is added to the torque: declare it, log it as injected, or "
            "identify by idim, which needs no controller."
        )


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis(Documented):
    """Diagnosis of an estimate: of each axis its parameters, its residual, its controller and its faults.

    Attributes:
        name: of the record of a joint, or of the robot.
        method: of the estimate.
        axes: the diagnosis of each: one of a joint.
        torques: of the record, beside the estimate's.
        feed_forward: "gravity" or "inverse-model" where the controllers leave much less with it; None otherwise.
        cause: of the whole log or model, that explains more than the faults of single axes.
    """

    in_json = "answer explained as_declared sentences reasons -torques"
    name: str
    method: str
    axes: tuple[AxisDiagnosis, ...]
    torques: AxisTorques
    feed_forward: str | None = None
    cause: RobotCause | None = None

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
        """True if no fault of loop, log or joint was found, and nothing of the torque is left unexplained."""
        return self.explained and self.as_declared is not False and not self._faulty

    @property
    def reasons(self) -> tuple[Message, ...]:
        """The faults found on all axes, or the tests that found none."""
        return tuple(reason for one in self.axes for reason in one.faults.reasons)

    def name_faults(self, *, of_model: bool) -> tuple[Message, ...]:
        """Return the faults found of models, or of loops and logs, each with its axis."""
        return tuple(
            _of_axis(axis, reason)
            for axis in self.axes
            for finding, reason in zip(axis.faults.findings, axis.faults.reasons, strict=False)
            if finding.test.fault.of_model is of_model
        )

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

    @property
    def untested_clause(self) -> str:
        """A clause on the controllers that cannot be tested; "" without any."""
        if not self.untested:
            return ""
        several = len(self.untested) > 1
        return (
            f"the controller{'s' * several} of {join(self.untested)} {'were' if several else 'was'} not checked, which "
            "needs a declared controller, a motor position and a reference"
        )

    def describe_laws(self, *, holds: bool) -> str:
        """Return the clause on the controllers that make the logged torques, or do not; "" without any."""
        names = [one.name for one in self.axes if one.law_holds is holds]
        if not names:
            return ""
        several = len(names) > 1
        which = "s" * several + ("" if holds and len(names) == len(self.axes) else self._of(names))
        verb = ("make" if several else "makes") if holds else f"{'do' if several else 'does'} not make"
        return f"the declared controller{which} {verb} the logged torque{'s' * several} of the logged positions"

    @property
    def sentences(self) -> tuple[str, ...]:
        """Faults of all axes, each with its remedy."""
        found = []
        if self.feed_forward is not None:
            found.append(
                f'With robot.feed_forward = "{self.feed_forward}" the controllers leave much less of the torques: '
                "declare it."
            )
        if self.cause is not None:
            found.append(sentence(str(self.cause)))
        if any(axis.caused for axis in self.axes):
            found.append("Correct this first, and identify again: other faults of single joints are named only then.")
        found += [one for axis in self.axes for one in axis.sentences]
        unknown = []
        for one in self.axes:
            if names := one.names(Told.NOT):
                more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
                unknown.append(f"{one.name and f'of {one.name} '}{', '.join(names[:_MOST_NAMES])}{more}")
        if unknown:
            found.append(
                f"These parameters are not significant: {'; '.join(unknown)}. On motions like this one, 0 predicts as "
                "well. Other motions need them: jointid design plans one that determines them."
            )
        return tuple(found)

    def _of(self, names: Sequence[str]) -> str:
        """Return the names of axes in a sentence, or none of a joint alone."""
        return f" of {join(names)}" if any(names) else ""

    @property
    def answer(self) -> str:
        """The diagnosis in short."""
        return " ".join(self._parts)

    @property
    def sentence(self) -> str:
        """Sentence of the first fault, or of none."""
        return self._parts[0]

    @property
    def _parts(self) -> tuple[str, ...]:
        """The sentences of the answer, what is wrong first."""
        bad = [one.name for one in self.axes if not one.explained]
        coloured = [one.name for one in self.axes if one.coloured]
        alone = len(self.axes) == 1
        left = ("{:.2g} %" if alone else "at most {:.2g} %").format(100 * max(a.left for a in self.axes))
        first = f"The model leaves {left} of the torque, which is noise as far as this record shows."
        if bad:
            first = f"The model does not explain the torque{self._of(bad)}."
        elif unjudged := [one.name for one in self.axes if not one.judged]:
            first = (
                f"The record is too short to tell whether what the model leaves of the torque{self._of(unjudged)} is "
                "noise: record longer."
            )
        elif coloured:
            every = "the" if alone else "every joint's"
            first = (
                f"The model leaves little of {every} torque, but its residual{self._of(coloured)} is not white."
                if all(one.left < _LEFT for one in self.axes if one.coloured)
                else "The residual of the torque is not white, but does not repeat with the motion."
            )
        count = sum(len(one.asked) for one in self.axes)
        stated = sum(len(one.names(Told.TOLD)) for one in self.axes)
        known = f"The record determines {stated} of {count} parameters within 10 %."
        faults = self._faults() if self.cause is None else sentence(str(self.cause))
        before, after = ("", faults) if bad and not self._faulty and self.cause is None else (faults, "")
        return tuple(filter(None, (before, first, after, *self._loops(), known)))

    @property
    def _faulty(self) -> list[str]:
        return [one.name for one in self.axes if one.faults.findings]

    def _faults(self) -> str:
        """Return the sentence on the faults that were tested; "" where none were."""
        tested = [one for one in self.axes if one.faults.tests]
        if self._faulty:
            found = [str(one.brief) for of_model in (False, True) for one in self.name_faults(of_model=of_model)]
            more = f", and {pluralise(len(found) - 1, 'more fault')}, see below" if len(found) > 1 else ""
            return sentence(f"{found[0]}{more}")
        if tested and all(one.faults.of_loop and one.law_holds is not False for one in tested):
            return "Loop and log are as declared, as far as this record shows."
        return ""

    def _loops(self) -> Iterator[str]:
        """Yield sentences on loops and logs from the logged positions."""
        untested = f"; {self.untested_clause}" if self.untested else ""
        if wrong := self.describe_laws(holds=False):
            yield sentence(f"{wrong}: unless these are rounded coarsely, do not rely on DIDIM there{untested}")
        elif held := self.describe_laws(holds=True):
            yield sentence(f"{held}{untested}")
        elif not any(one.faults.of_loop for one in self.axes):
            why = (
                "is not seen apart from the model: no motor position and reference were logged"
                if self.method == "didim"
                else "is not asked: the file declares none, or the record has no reference"
            )
            yield f"Whether the {'controllers are' if len(self.axes) > 1 else 'controller is'} as declared {why}."

    def to_document(self, *, details: bool = False) -> Document:
        """Return the answer, a table of the axes, and what to do.

        Args:
            details: whether all tests are listed.
        """
        header: tuple[str, ...] = ("joint", "left, %", "white", "known", "roughly", "unknown")
        if any(one.law for one in self.axes):
            header = (*header, "controller leaves, %", "any law, %")
        rows = tuple(_row(one)[: len(header)] for one in self.axes)
        caption = "residual of each joint's filtered torque, and how many parameters the record determines"
        good = self.explained and all(one.judged for one in self.axes) and self.as_declared is not False
        blocks: list[Block] = [
            Facts((("record", f"{self.name}, {pluralise(len(self.axes), 'joint')}"),)),
            Paragraph(" ".join(self._parts[1:]), tone="good" if good else "bad"),
            Table(header, rows, caption, (0, 2)),
            *((Heading("What to do"), Listing(self.sentences)) if self.sentences else ()),
            *self._tests(details),
        ]
        return Document(self.sentence, tuple(blocks))

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


def _row(one: AxisDiagnosis) -> tuple[str, ...]:
    white = "-" if one.whiteness is None else "yes" if one.whiteness.white else "no"
    law = ("-", "-") if one.law is None else (f"{100 * one.law.left:.3g}", f"{100 * one.law.noise:.2g}")
    stated = (one.names(Told.TOLD), one.names(Told.ROUGHLY), one.names(Told.NOT, Told.REFUSED))
    return (one.name or "joint", f"{100 * one.left:.3g}", white, *(str(len(names)) for names in stated), *law)
