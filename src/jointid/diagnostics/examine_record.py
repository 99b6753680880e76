"""Examination of a new record: its faults, and the diagnosis of the joint that is identified from it.

The checks are those of other modules, in the order in which one fault spoils the next: clock, torque, motion,
controller, joint. The joint is identified once.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from jointid.common.document import Block, Document, Documented, Facts, Heading, Paragraph, Verdicts
from jointid.common.errors import FaultsError, JointidError, MethodError
from jointid.common.messages import Message, Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.parameters import Parameter
from jointid.common.text import join, number
from jointid.common.transmission import Transmission
from jointid.diagnostics.diagnose import OF_ROBOT, FeedForwardName, diagnose
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.faults.record import find_plain_cause, find_standstill
from jointid.diagnostics.find_causes import find_causes
from jointid.diagnostics.identify import identify
from jointid.diagnostics.law_comparison import LawComparison
from jointid.diagnostics.model_free import Agreement, compare_law, judge_law
from jointid.estimation.methods.registry import Method
from jointid.estimation.result.answer import loop_verdict
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Controller
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import ClosedLoop, Joint, RigidJoint
from jointid.models.robots.robot import Robot
from jointid.records.checks import find_record_warnings, limit_faults, still_faults
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.verdict import POOR_FIT, Reason, Status, Subject

_NO_RESPONSE = 0.3  # of the torque: so much that is no response to the reference says more than how a search ended


class Question(StrEnum):
    """The questions, in their order."""

    RECORD = "record"
    CLOCK = "clock"
    TORQUE = "torque"
    LIMIT = "torque limit"
    MOTION = "motion"
    LAW = "controller"
    LOOP = "loop and log"
    FIT = "joint"
    PARAMETERS = "parameters"


class Fault(StrEnum):
    """Codes of the faults of a record; a cause of `find_causes` keeps its own."""

    UNREADABLE = "unreadable"
    CLOCK_UNEVEN = "clock_uneven"
    TORQUE_COARSE = "torque_coarse"
    AT_LIMIT = "at_limit"
    MOTION_POOR = "motion_poor"
    JOINT_DIFFERS = "joint_differs"
    NOT_IDENTIFIED = "not_identified"


_ENOUGH = (Fault.MOTION_POOR, Agreement.SCALED, Agreement.LATE)
"""Faults after which no joint is identified."""
_VAGUE = (Agreement.DIFFERS, Fault.JOINT_DIFFERS, str(Reason.NO_CAUSE_FOUND))
"""Faults of unknown cause."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to one question.

    Attributes:
        question: that was asked.
        good: True or False; None where it cannot be said.
        said: observations with their numbers; the remedy of a fault.
        fault: None where there is none.
        axis: name of the joint of a robot; "" of a joint alone, and of all joints.
    """

    question: Question
    good: bool | None
    said: tuple[str, ...]
    fault: str | None = None
    axis: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Examination(Documented):
    """Faults of a record, and what the joint's identification from it tells.

    Attributes:
        record: its name.
        logged: its channels, in a sentence.
        answers: to the questions that apply.
        diagnosis: of the estimate; None where no joint was identified, or its loop is not simulated.
        laws: comparisons of the laws of springs and frictions, where they were asked for.
        transmission: on whose `side` all numbers are.
    """

    in_json = "healthy sentence"
    record: str
    logged: str
    answers: tuple[Answer, ...]
    diagnosis: Diagnosis | None = None
    laws: tuple[LawComparison, ...] = ()
    transmission: Transmission | None = None

    @property
    def healthy(self) -> bool:
        """True without faults; a parameter that is not identifiable is no fault."""
        return not self.faults

    @property
    def faults(self) -> tuple[Answer, ...]:
        """Answers that name a fault."""
        return tuple(one for one in self.answers if one.good is False)

    @property
    def finds_nothing(self) -> bool:
        """True if neither the record has a fault nor loop, log and joint differ from what is declared."""
        return self.healthy and (self.diagnosis is None or self.diagnosis.finds_nothing)

    @property
    def sentence(self) -> str:
        """The first fault in a sentence."""
        if not self.healthy:
            named = [one for one in self.faults if one.fault not in _VAGUE] or [*self.faults]
            return f"{self.record}: {named[0].axis and f'{named[0].axis}: '}{named[0].said[0]}."
        if marked := list(dict.fromkeys(str(one.question) for one in self.answers if one.good is None)):
            return f"Nothing that is wrong with {self.record} spoils its answer; see {join(marked)}, marked with ?."
        return f"Nothing is wrong with {self.record}."

    def to_document(self, *, details: bool = False) -> Document:
        """Return the answers, then the diagnosis and the laws."""
        blocks: list[Block] = []
        if self.logged:
            blocks.append(Paragraph(self.logged))
        for axis in dict.fromkeys(one.axis for one in self.answers):
            own = tuple((str(one.question), one.good, one.said) for one in self.answers if one.axis == axis)
            blocks += [*([Heading(axis)] if axis else []), Verdicts(own)]
        if self.transmission is not None:
            blocks.append(Facts((("transmission", str(self.transmission)),)))
        parts = [] if self.diagnosis is None else [self.diagnosis.to_document(details=details)]
        for part in (*parts, *(one.to_document() for one in self.laws)):
            blocks += [Heading(part.title), *part.blocks]
        return Document(self.sentence, tuple(blocks))


def unreadable(error: FaultsError, record: str) -> Examination:
    """Return the examination of a file from which no record could be made."""
    checked = tuple(Answer(Question.RECORD, False, (_clause(one),), Fault.UNREADABLE) for one in error.faults)
    return Examination(record, "", checked)


@one_thread()
def examine(
    record: Record | Sequence[Record],
    model: ClosedLoop | DriveSide | Joint | Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    shown: Sequence[DriveNumber] = (),
    controllers: Sequence[Controller | None] = (),
    feed_forward: FeedForwardName = "none",
    progress: Progress = ignore_progress,
) -> Examination:
    """Examine clock, torque, motion and controller of a record, and diagnose the joint that is identified from it.

    Args:
        record: to examine; of a robot those of its joints.
        model: the loop (joint and controller), or the joint alone, or a robot; see `jointid.identify`.
        method: of the identification; see `jointid.identify`, as for the next two.
        filtering: of the identification.
        parameters: changes to the joint's parameters.
        shown: how the drive shows the numbers of its controller, as `jointid.config.File.declared_numbers` has it;
            without it they are given in SI.
        controllers: of each joint of a robot, see `jointid.diagnose`, as for the next.
        feed_forward: kind of the injected signals of a robot's records.
        progress: called with each step in a sentence.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin("L19", noise="white")
        >>> found = ji.examine(axis.record, axis.loop)
        >>> print(found.sentence)
        Nothing is wrong with twin L19.
    """
    if isinstance(record, Record) and (controllers or feed_forward != "none"):
        raise MethodError(OF_ROBOT)
    axes = _list_axes(record, model)
    first = axes[0].record
    loop, gear = (axes[0].loop, axes[0].joint.transmission) if len(axes) == 1 and not axes[0].name else (None, None)
    checked = [Answer(Question.RECORD, None, first.remarks)] if first.remarks else []
    checked += [_check_clock(first), *(replace(one, axis=axis.name) for axis in axes for one in _check_axis(axis))]
    checked.sort(key=lambda one: one.question is not Question.RECORD)

    about = f"{', '.join(first.channels).replace('_', ' ')}, {first.duration:.6g} s."

    def conclude(diagnosis: Diagnosis | None = None) -> Examination:
        return Examination(first.name, about, tuple(checked), diagnosis, transmission=gear)

    if any(one.fault in (*_ENOUGH, Fault.UNREADABLE) for one in checked):  # no joint would be right
        return conclude()
    try:
        estimate = identify(
            record, model, method, filtering=filtering, parameters=parameters, shown=shown, progress=progress
        )
    except JointidError as error:
        checked.append(_explain(error, first, loop, shown, progress))
        return conclude()
    checked += _check_estimate(estimate)
    made = estimate.checks.diagnosis
    diagnosis = made if isinstance(made, Diagnosis) else None
    declared = not isinstance(model, RobotLoop) and any(one is not None for one in controllers)
    if diagnosis is not None and (declared or feed_forward != "none"):
        with contextlib.suppress(JointidError):  # the diagnosis that was made stands
            diagnosis = diagnose(estimate, record, controllers=controllers, feed_forward=feed_forward)
    return conclude(diagnosis)


@dataclass(frozen=True, slots=True)
class _Axis:
    """A joint alone, or of a robot: its record, and its loop where the controller is known."""

    name: str
    record: Record
    joint: Joint
    loop: ClosedLoop | None


def _list_axes(record: object, model: object) -> list[_Axis]:
    """Return the joint, or those of a robot.

    Raises:
        MethodError: it is another model, or there are not as many records as joints.
    """
    if isinstance(model, Robot | RobotLoop | RobotDriveSide):
        robot = model if isinstance(model, Robot) else model.robot
        laws = model.controllers if isinstance(model, RobotLoop) else (None,) * len(robot)
        if not isinstance(record, Sequence) or len(record) != len(robot):
            raise MethodError(f"A robot of {len(robot)} joints is examined with as many records: give one a joint.")
        joints = [RigidJoint(link.kind) for link in robot.links]
        return [
            _Axis(name, one, joint, None if law is None else ClosedLoop(joint, law))
            for name, one, joint, law in zip(robot.names, record, joints, laws, strict=True)
        ]
    if not (isinstance(record, Record) and isinstance(model, ClosedLoop | DriveSide | Joint)):
        raise MethodError("A record is examined with the ClosedLoop or DriveSide of its joint, or with the joint.")
    joint = model.joint if isinstance(model, ClosedLoop | DriveSide) else model
    return [_Axis("", record, joint, model if isinstance(model, ClosedLoop) else None)]


def _check_axis(axis: _Axis) -> Iterator[Answer]:
    """Yield the answers on missing channels, torque, torque limit, motion and controller of a joint."""
    record, loop = axis.record, axis.loop
    missing = [name for name in ("torque", *(() if loop is None else loop.channels)) if getattr(record, name) is None]
    if missing:
        names = " and ".join(dict.fromkeys(missing))
        said = f"the record has no {names}, without which this joint is not identified; log it"
        yield Answer(Question.RECORD, False, (said,), Fault.UNREADABLE)
    yield from _check_samples(record, loop)
    law = None if loop is None else compare_law(record, loop)
    if law is not None:
        judged = judge_law(law, record)
        holds = judged.code is Agreement.HOLDS
        yield Answer(Question.LAW, holds, (judged.words,), None if holds else str(judged.code))


def _check_samples(record: Record, loop: ClosedLoop | None) -> Iterator[Answer]:
    """Yield the answers on torque, torque limit and motion."""
    torque = record.torque
    if torque is not None:
        still = [_clause(one) for one in still_faults(record)]
        coarse = find_record_warnings(replace(record, remarks=()), ("torque",))
        said = f"{number(float(torque.values.min()), 3)} to {number(float(torque.values.max()), 3)} {torque.unit}"
        if still:
            yield Answer(Question.TORQUE, False, (*still, said), Fault.MOTION_POOR)
            return
        yield Answer(Question.TORQUE, not coarse, (*coarse, said), Fault.TORQUE_COARSE if coarse else None)
        limit = math.inf if loop is None else loop.controller.law(torque.sample_time).limit
        if math.isfinite(limit):
            wrong = [*limit_faults(record, limit)]
            reached = float(np.max(np.abs(torque.values))) / limit
            said = f"the torque reaches {number(100 * reached, 3)} % of {number(limit, 4)} {torque.unit}"
            yield Answer(
                Question.LIMIT, not wrong, tuple(map(_clause, wrong)) or (said,), Fault.AT_LIMIT if wrong else None
            )
    if record.reference is not None and torque is not None:
        yield _check_motion(record, loop)


def _check_clock(record: Record) -> Answer:
    times = sorted({channel.sample_time for _, channel in record.items()})
    rates = " and ".join(f"{1e3 * one:.6g} ms" for one in times)
    said = f"{number(record.duration, 4)} s, a sample every {rates}"
    if record.resampled is None:
        return Answer(Question.CLOCK, True, (said,))
    uneven = record.resampled.rms > 0.1 or record.resampled.gaps > 0
    return Answer(
        Question.CLOCK, not uneven, (f"{said}, resampled {record.resampled}",), Fault.CLOCK_UNEVEN if uneven else None
    )


def _check_motion(record: Record, loop: ClosedLoop | None) -> Answer:
    plain: Message | None = find_plain_cause(record)
    if plain is None and loop is not None:
        plain = find_standstill(record, loop)
    if plain is not None:
        return Answer(Question.MOTION, False, (plain.words,), Fault.MOTION_POOR)
    reference = record.reference
    assert reference is not None
    velocity = np.gradient(reference.values, reference.sample_time)
    fastest = float(np.max(np.abs(velocity)))
    said = f"{number(float(np.ptp(reference.values)), 3)} {reference.unit} of travel, up to "
    said += f"{number(fastest, 3)} {reference.unit}/s"
    return Answer(Question.MOTION, True, (said,))


def _explain(
    error: JointidError, record: Record, loop: ClosedLoop | None, shown: Sequence[DriveNumber], progress: Progress
) -> Answer:
    """Return the cause of a failed identification; its error if none is found."""
    said = tuple(_clause(one) for one in (error.faults if isinstance(error, FaultsError) else (str(error),)))
    try:
        causes = None if loop is None else find_causes(record, loop, shown=shown, progress=progress)
    except (JointidError, np.linalg.LinAlgError):
        causes = None
    if causes is None or not (causes.found or causes.unexplained > _NO_RESPONSE):
        return Answer(Question.FIT, False, said, Fault.NOT_IDENTIFIED)
    named = causes.explanations
    fault = named[0].fault.name if named else str(causes.message.code)
    return Answer(Question.FIT, False, (causes.message.words,), fault)


def _check_estimate(estimate: Estimate) -> Iterator[Answer]:
    """Yield the answers on the loop and the fit of an estimate."""
    loop, fit = loop_verdict(estimate), estimate.fit
    if loop is not None and loop.status is Status.PASSED:
        yield Answer(Question.LOOP, True, ("as declared, as far as this record shows",))
    elif loop is not None:
        values = loop.reasons[0].values
        causes = values.get("causes")
        fault = str(causes[0]["cause"] if causes else values.get("suspect", loop.reasons[0].code))
        spoils = loop.status is Status.FAILED and not estimate.answer.reliable
        said = tuple(one.words for one in loop.reasons[:2])
        yield Answer(Question.LOOP, False if spoils else None, said, fault if spoils else None)
    for scale in (v for v in estimate.checks.verdicts if v.subject is Subject.SCALE):
        yield Answer(Question.LOOP, True if scale.status is Status.PASSED else None, (scale.said,))
    model = "joint" if estimate.robot is None else "robot"
    for axis, error in (fit.axis_errors or {"": fit.filtered_error}).items():
        left = f"{number(100 * error, 2)} % of the {estimate.signal} is not explained by the {model}"
        poor = not error <= POOR_FIT
        yield Answer(Question.FIT, not poor, (left,), Fault.JOINT_DIFFERS if poor else None, axis)


def _clause(sentence: str) -> str:
    return sentence.removesuffix(".")
