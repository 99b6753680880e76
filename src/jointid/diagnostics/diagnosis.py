"""Diagnosis of an estimate by axis: faults of loop, log and joint.

The residual torque is tested for whiteness, and for the signature of each fault. The controller's torque is compared
along the logged motor position, which distinguishes its faults from those of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Table, Text
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.parallel import in_threads
from jointid.common.text import join, number, sentence
from jointid.common.transmission import Transmission
from jointid.diagnostics.axis_torques import AxisTorques, is_noise, torques_of_loop, torques_of_robot
from jointid.diagnostics.changes import OTHER_LAWS, Cause
from jointid.diagnostics.law_comparison import LawComparison
from jointid.diagnostics.model_free import Agreement, LawOnPosition, compare_law
from jointid.diagnostics.robot_causes import find_copied_reference, find_robot_cause
from jointid.diagnostics.score import SolvedLoop
from jointid.diagnostics.search import search_axes, search_faults
from jointid.diagnostics.suspects import AxisFaults
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import Reason, Subject
from jointid.models.controllers import Controller
from jointid.models.controllers.servo_base import require_one_each
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.robots.robot import RobotLoop
from jointid.records.record import Record
from jointid.simulation.controller_torque import SOURCE
from jointid.uncertainty.model_tests import Whiteness
from jointid.uncertainty.position_dependent_error import cells, repeatable

JOINT_DIFFERS = "joint_differs"  # the symptom of a joint whose torque the model does not explain
_VAGUE = (Agreement.DIFFERS, JOINT_DIFFERS, str(Reason.NO_CAUSE_FOUND))  # symptoms of unknown cause


@dataclass(frozen=True, slots=True)
class Symptom:
    """A fault or an open question of a record or its estimate.

    Attributes:
        code: of the symptom, or of the cause that was found.
        said: clause with its numbers and its remedy.
        axis: name of the joint of a robot; "" for a single joint and for all joints.
        spoils: whether it makes the estimate unreliable.
    """

    code: str
    said: str
    axis: str = ""
    spoils: bool = True

    def __str__(self) -> str:
        return f"{self.axis and f'{self.axis}: '}{self.said.removesuffix('.')}"


@dataclass(frozen=True, slots=True, eq=False)
class AxisDiagnosis:
    """Diagnosis of one axis.

    Attributes:
        name: of the joint; empty of a joint alone.
        left: residual share of its filtered torque.
        whiteness: of the residual; None if the record is too short.
        near: Hz; half of the residual's squares or more are within a tenth of it, and None if it has no such frequency.
        law: comparison of the declared controller with the logged torque; None without a controller, a reference or a
            logged motor position.
        faults: that were tested, and those found.
        repeats: whether the residual repeats with the axis's motion; None if not tested.
        caused: whether a cause that is not of this axis alone explains the residual.
        signal: the compared signal: "torque", or one that is computed from the position.
    """

    in_json = "explained as_declared law_holds"
    name: str
    left: float
    whiteness: Whiteness | None
    near: float | None
    law: LawOnPosition | None
    faults: AxisFaults
    repeats: bool | None = None
    caused: bool = False
    signal: str = "torque"

    @property
    def explained(self) -> bool:
        """True if the residual is small or noise, as far as tested."""
        return is_noise(self.left, self.whiteness) or (self.repeats is False and not self.faults.findings)

    @property
    def law_holds(self) -> bool | None:
        """Whether the declared controller outputs the logged torque; None if untested."""
        return None if self.law is None else self.law.holds

    @property
    def as_declared(self) -> bool | None:
        """False if loop, log or controller has a fault; None if untested."""
        faulty = any(not (self.name and one.test.fault.of_model) for one in self.faults.findings)
        if faulty or self.law_holds is False or self.faults.part is not None:
            return False
        return True if self.law_holds or not self.name else None  # of a robot's axis no loop is simulated alone

    @property
    def reasons(self) -> tuple[Message, ...]:
        """Faults of the axis with remedies, preceded by its name."""
        found, begin = self.faults.reasons, f"{self.name}: " if self.name else ""
        if self.faults.as_declared:
            said = "the model leaves more than noise, which no fault explains: check its geometry, gears and couplings"
            found = () if self.caused or self.explained else (Message(Reason.RESIDUAL_FOLLOWS_MOTION, said),)
        of = {"axes": [self.name]} if self.name else {}
        return tuple(Message(one.code, begin + one.words, {**one.values, **of}, begin + one.brief) for one in found)


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis(Documented):
    """Diagnosis of a record, and of the estimate from it.

    Attributes:
        name: of the record of a joint, or of the robot.
        method: of the estimate; empty if nothing could be identified.
        axes: the diagnosis of each: one of a joint; none where nothing could be identified.
        torques: of the record, beside the estimate's.
        cause: of the whole log or model, that explains more than the faults of single axes.
        symptoms: of the record and its estimate, the first first; none in the diagnosis that an estimate has.
        laws: comparisons of the laws of springs and frictions, if requested.
        transmission: on whose `side` all numbers are.
    """

    in_json = "healthy explained as_declared sentence sentences -torques"
    name: str
    method: str = ""
    axes: tuple[AxisDiagnosis, ...] = ()
    torques: AxisTorques | None = None
    cause: Cause | None = None
    symptoms: tuple[Symptom, ...] = ()
    laws: tuple[LawComparison, ...] = ()
    transmission: Transmission | None = None

    @property
    def healthy(self) -> bool:
        """True if no symptom makes the answer unreliable."""
        return not any(one.spoils for one in self.symptoms)

    @property
    def explained(self) -> bool:
        """True if the model explains every axis's torque, without a common cause."""
        return self.cause is None and all(one.explained for one in self.axes)

    @property
    def as_declared(self) -> bool | None:
        """Whether loops and logs are as declared; None if one is untested."""
        seen = [one.as_declared for one in self.axes]
        return False if False in seen else None if None in seen else True

    def name_faults(self, *, of_model: bool) -> tuple[Message, ...]:
        """Findings on models, or on loops, logs and record parts, by axis."""
        found = list[Message]()
        for axis in self.axes:
            named = zip(axis.faults.findings, axis.reasons, strict=False)
            found += [] if of_model or axis.faults.part is None else axis.reasons
            found += [reason for one, reason in named if one.test.fault.of_model is of_model]
        return (*found, *(() if of_model else self._wrong_laws))

    @property
    def _wrong_laws(self) -> tuple[Message, ...]:
        """Message on declared controllers that contradict the logged torques, if any."""
        names = [one.name for one in self.axes if one.law_holds is False]
        of = f" of {join(names)}" if any(names) else ""
        said = f"the declared controller{of} does not make the logged torque of the position"
        return (Message(Reason.LOOP_NOT_AS_DECLARED, said, {"axes": names} if any(names) else {}),) if names else ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """Faults of all axes, each with its remedy."""
        then = "Correct this first, and identify again: single joints are judged only then"
        found = [] if self.cause is None else [f"{self.cause.words}. {then}"]
        found = [*map(sentence, (*found, *(one.words for one in self._wrong_laws)))]
        said = dict[str, list[str]]()  # what several joints have in common is one sentence
        for name, words in ((axis.name, one.words) for axis in self.axes for one in axis.reasons):
            said.setdefault(words.removeprefix(f"{name}: "), []).append(name)
        return *found, *(f"{join(of)}: {words}." if of[0] else sentence(words) for words, of in said.items())

    @property
    def sentence(self) -> str:
        """The first fault in a sentence."""
        first = min(self.symptoms, key=lambda one: (not one.spoils, one.code in _VAGUE), default=None)
        if first is not None:
            said = f"{self.name}: " if first.spoils else f"No fault of {self.name} affects its answer: "
            return f"{said}{first}."
        return self.sentences[0] if self.sentences else f"Nothing is wrong with {self.name}."

    def to_document(self, *, details: bool = False) -> Document:
        """The diagnosis as a document: further findings, a table of the axes, and comparisons of laws."""
        said, others = self.sentence, list[str]()
        for one in map(sentence, (*map(str, self.symptoms), *(() if details else self.sentences))):
            if one[1:-1] not in said:
                said, others = said + one, [*others, one]
        blocks: list[Block] = [Text("Further findings", "heading"), Text("\n".join(others), "list")] if others else []
        blocks += [] if self.transmission is None else [Facts((("transmission", str(self.transmission)),))]
        blocks += [self._table()] if self.axes else []
        for part in (one.to_document() for one in self.laws):
            blocks += [Text(part.title, "heading"), *part.blocks]
        return Document(self.sentence, tuple(blocks))

    def _table(self) -> Table:
        """Residuals of each axis's torque, by model and by controller."""
        header = ("joint", "left, %", "white", "most near, Hz", "controller leaves, %", "any law, %")
        rows = []
        for one in self.axes:
            white = "-" if one.whiteness is None else "yes" if one.whiteness.white else "no"
            law = ("-", "-") if one.law is None else (f"{100 * one.law.left:.3g}", f"{100 * one.law.noise:.2g}")
            rows.append((one.name or "joint", f"{100 * one.left:.3g}", white, number(one.near, 3), *law))
        return Table(header, tuple(rows), f"residual of each joint's filtered {self.axes[0].signal}", (0, 2))


def diagnose_joint(
    estimate: Estimate, record: Record, problem: ClosedLoopProblem, x: FloatArray, **asked: Any
) -> Diagnosis:
    """Diagnose a joint's DIDIM estimate from its solved problem, as is asked of `search_faults`."""
    std = {p.name: p.stderr for p in estimate.rows if p.stderr is not None}
    law = compare_law(record, problem.loop)
    proved = problem.loop if law is not None and law.holds else None
    faults = search_faults(SolvedLoop(problem, x, std, record, proved), **asked)
    torques = torques_of_loop(problem, x)
    repeats = next((not one.passed for one in estimate.about(Subject.REPEATABLE) if one.passed is not None), None)
    axis = AxisDiagnosis("", *torques.judge(0), law, faults, repeats, signal=estimate.signal)
    return Diagnosis(record.name, estimate.settings.method, (axis,), torques)


def diagnose_robot(
    estimate: Estimate, records: Sequence[Record], controllers: Sequence[Controller | None] = ()
) -> Diagnosis:
    """Diagnose a robot's estimate by any method, from its joints' records.

    `controllers` are as declared, None for an unknown one; by default those of the estimate's loop.
    """
    part, method = estimate.require_robot(), estimate.settings.method
    robot, torques = part.model, torques_of_robot(estimate, records)
    if not controllers and isinstance(part.setup, RobotLoop):
        controllers = part.setup.controllers
    require_one_each(controllers, len(robot))
    each = zip(robot.links, records, controllers or [None] * len(robot), strict=True)
    loops = [(record, None if law is None else ClosedLoop(RigidJoint(link.kind), law)) for link, record, law in each]
    laws = in_threads(lambda one: None if one[1] is None else compare_law(one[0], one[1]), loops)
    units = [(robot.position_unit(k), robot.torque_unit(k)) for k in range(len(robot))]
    try:
        faults = search_axes(torques, units)
    except np.linalg.LinAlgError:
        said = "What is left of this record cannot be tested, as where an axis stands still: let every axis move."
        raise MethodError(said) from None
    axes = list[AxisDiagnosis]()
    for k, (record, found, law) in enumerate(zip(records, faults, laws, strict=True)):
        inside, repeats = torques.seen[k], None
        # The noise of a torque that is computed from the controller, at some frequencies at least, is coloured.
        if record.torque is not None and record.torque.source.endswith(SOURCE):
            where = cells(torques.position[k][inside], torques.velocity[k][inside])
            seen = repeatable(torques.error[k][inside], where)
            repeats = seen.significant if seen.p_value is not None else None  # too little was visited twice
        axes.append(AxisDiagnosis(robot.names[k], *torques.judge(k), law, found, repeats, signal=estimate.signal))
    cause = find_copied_reference(robot, records)
    # DIDIM and the drive side take a wrong model for another robot: their search ends elsewhere.
    if not (cause or estimate.settings.simulates or all(one.whiteness and one.whiteness.white for one in axes)):
        cause = find_robot_cause(robot, records, estimate.settings.filtering)
    for k, axis in enumerate(axes if cause is not None else ()):  # which explains faults, but no use of a reference
        kept = tuple(one for one in axis.faults.findings if one.test.name in OTHER_LAWS)
        axes[k] = replace(axis, faults=replace(axis.faults, findings=kept, part=None), caused=True)
    return Diagnosis(robot.name, method, tuple(axes), torques, cause)
