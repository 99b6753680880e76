"""`diagnose`: faults of a record, its loop and its joint.

The record is examined first: clock, torque, motion, controller. The joint is then identified once, and loop, log and
joint are tested (`diagnosis`). If no joint can be identified, the causes are searched for.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.parameters import Parameter
from jointid.common.text import number
from jointid.diagnostics.diagnosis import JOINT_DIFFERS, Diagnosis, Symptom, diagnose_robot
from jointid.diagnostics.explain import explain_failure
from jointid.diagnostics.identify import begin_checked, identify
from jointid.diagnostics.law_comparison import LawComparison, compare_laws
from jointid.diagnostics.model_free import Agreement, compare_law, find_plain_cause
from jointid.estimation.methods import Method
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import POOR_FIT, Subject
from jointid.models.controllers import Controller
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.checks import find_record_warnings, limit_faults, still_faults
from jointid.records.record import Record, takes_record
from jointid.records.signals.filtering import Filtering

_POOR_MOTION = "motion_poor"
_ENOUGH = (_POOR_MOTION, Agreement.SCALED, Agreement.LATE)  # after these no joint would be right


@one_thread
@takes_record
def diagnose(
    record: Record | Sequence[Record],
    model: ClosedLoop | Joint | Robot | RobotLoop,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    controllers: Sequence[Controller | None] = (),
    laws: bool = False,
    search: Callable[..., Estimate] = identify,
    progress: Progress = ignore_progress,
) -> Diagnosis:
    """Find faults of a record, its clock, loop, log and joint.

    Clock, torque, motion and controller of the record are examined. Then of each axis the residual is tested for
    whiteness and for what it correlates with, and each possible fault of loop, log and mechanics by its effect on the
    torque.

    Args:
        record: to examine; of a robot those of its joints.
        model: the loop (joint and controller), or the joint alone, or a robot; see `jointid.identify`.
        method: of the identification; see `jointid.identify`, as for the next two.
        filtering: of the identification.
        parameters: changes to the joint's parameters.
        controllers: of each joint of a robot as declared, None for an unknown one; by default those of the
            loop.
        laws: whether to identify a joint with every law of its spring and its friction, too, and to judge each by how
            well it predicts parts of the record that were kept from its fit.
        search: called as `jointid.identify`, in its place.
        progress: called with each step in a sentence.

    Raises:
        MethodError: records and model do not fit.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin("L19", noise="white")
        >>> found = ji.diagnose(axis.record, axis.loop)
        >>> print(found.sentence)
        Nothing is wrong with twin L19.
    """
    if isinstance(record, Record) and controllers:
        raise MethodError("The argument controllers is for a robot; leave it out for a joint.")
    if laws and not isinstance(model, ClosedLoop):
        raise MethodError("Laws are compared for a joint in its closed loop; give that, or of a robot one axis.")
    if isinstance(model, Estimate):
        raise MethodError("An estimate has its own diagnosis; give the loop, the joint or the robot to identify.")
    axes = _list_axes(record, model)
    (_, first, loop), each = axes[0], [own for _, own, _ in axes]
    symptoms = [Symptom("remark", one, spoils=False) for one in first.remarks]
    if first.resampled is not None and (first.resampled.rms > 0.1 or first.resampled.gaps > 0):
        symptoms.append(Symptom("clock_uneven", f"the clock is uneven: resampled {first.resampled}"))
    symptoms += [replace(one, axis=axis) for axis, own, law in axes for one in _examine(own, law)]
    found, compared = Diagnosis(first.name), list[LawComparison]()
    if not any(one.code in _ENOUGH for one in symptoms):
        try:
            if begin_checked(each, [one.controller for *_, one in axes if one is not None]) is not each:
                search = partial(identify, checks="whole")
            estimate = search(record, model, method, filtering=filtering, parameters=parameters, progress=progress)
        except JointidError as error:
            told = error if error.code else explain_failure(error, first, loop if len(axes) == 1 else None, progress)
            symptoms.append(Symptom(told.code, str(told).removesuffix(".")))
        else:
            symptoms += _examine_estimate(estimate)
            made = estimate.diagnosis
            found = made if isinstance(made, Diagnosis) else found
            if found.axes and not isinstance(model, RobotLoop) and any(one is not None for one in controllers):
                with contextlib.suppress(JointidError):  # the diagnosis that was made stands
                    found = diagnose_robot(estimate, each, controllers)
    if laws and isinstance(record, Record) and loop is not None:
        settings = method if isinstance(method, DIDIM) else None
        kinds: tuple[Literal["spring", "friction"], ...] = ("spring", "friction")
        try:
            for kind in kinds[loop.joint.model == "rigid" :]:
                compared.append(compare_laws(record, loop, kind, filtering, parameters, settings, progress))
        except JointidError as error:
            symptoms.append(Symptom("laws_not_compared", str(error), spoils=False))
    gear = getattr(getattr(model, "joint", model), "transmission", None)
    return replace(found, name=first.name, symptoms=tuple(symptoms), laws=tuple(compared), transmission=gear)


def _list_axes(record: Record | Sequence[Record], model: object) -> list[tuple[str, Record, ClosedLoop | None]]:
    """Name, record and known loop of each joint; refuse another number of records."""
    robot = model if isinstance(model, Robot) else getattr(model, "robot", None)
    names = ("",) if robot is None else robot.names
    loops = getattr(model, "loops", [model if isinstance(model, ClosedLoop) else None] * len(names))
    records = [record] if isinstance(record, Record) else [*record]
    if len(records) != len(names):
        raise MethodError(f"{len(names)} joints are examined with a record of each; received {len(records)}.")
    return list(zip(names, records, loops, strict=True))


def _examine(record: Record, loop: ClosedLoop | None) -> Iterator[Symptom]:
    """Yield faults of torque, limit, motion and controller; missing channels fail later."""
    torque = record.torque
    if torque is None:
        return
    if still := [*still_faults(record)]:
        yield from (Symptom(_POOR_MOTION, one) for one in still)
        return
    yield from (Symptom("torque_coarse", one) for one in find_record_warnings(replace(record, remarks=()), ("torque",)))
    limit = math.inf if loop is None else loop.controller.law(torque.sample_time).limit
    yield from (Symptom("at_limit", one) for one in limit_faults(record, limit))
    if record.reference is not None and (plain := find_plain_cause(record)) is not None:
        yield Symptom(_POOR_MOTION, plain.words)
    law = None if loop is None else compare_law(record, loop)
    if law is not None and law.agreement.code is not Agreement.HOLDS:
        yield Symptom(str(law.agreement.code), law.agreement.words)


def _examine_estimate(estimate: Estimate) -> Iterator[Symptom]:
    """Yield faults of an estimate's loop and fit, and its undecided checks."""
    loop, fit = estimate.about(Subject.LOOP), estimate.fit
    if loop and not loop[0].passed:
        values = loop[0].values
        causes = values.get("causes")
        code = str(causes[0]["cause"] if causes else values.get("suspect", loop[0].code))
        spoils = loop[0].passed is False and not estimate.answer.reliable
        yield Symptom(code, "; ".join(one.words for one in loop[:2]), spoils=spoils)
    for axis, error in (fit.axis_errors or {"": fit.filtered_error}).items():
        if not error <= POOR_FIT:
            left = f"{number(100 * error, 2)} % of the {estimate.signal} is not explained by the model"
            yield Symptom(JOINT_DIFFERS, left, axis)
