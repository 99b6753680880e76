"""Gross faults of the record: signs, swapped channels, a sample time, a motion as reference, a spring."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jointid.common.errors import JointidError
from jointid.diagnostics.faults.fault import Fault, Hypothesis, Meaning
from jointid.diagnostics.faults.loop_gain import LAW_GAIN, say_times
from jointid.diagnostics.hypothesis_fits import MORE, Fit, fit_flexible, follow
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.drive_side import grid_starts, motion_problem
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.problems.base import log_delay
from jointid.models.controllers import numbers_of
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import DriveSide

_TIMES = (0.1, 0.125, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 8.0, 10.0)  # times the sample time: rates that drives log at
_BY_TIME = 0.6  # of the declared error: a sample time that is wrong by a factor spoils all of a fit
_FLEXIBLE = 2.0  # times: reduction of the residual by a mode; its parameters absorb a third of an unmodelled friction


def _invert_torque(declared: Hypothesis) -> Iterator[Hypothesis]:
    torque = declared.record.torque
    assert torque is not None
    inverted = {"torque": replace(torque, values=-torque.values)}
    yield replace(declared, record=declared.record.with_channels(inverted))


REFERENCE_SIGN = Fault("reference_sign", "sign of the reference")


def _explain_sign(*_: object) -> Iterator[Meaning]:
    yield TORQUE_SIGN, "the torque has the wrong sign (set record.channels.torque.sign = -1)", None
    yield REFERENCE_SIGN, "the reference has the wrong sign (set record.channels.reference.sign = -1)", None


TORQUE_SIGN = Fault(
    "torque_sign", "sign of the torque", correct=_invert_torque, meanings=_explain_sign,
)  # fmt: skip


def _swap_channels(declared: Hypothesis) -> Iterator[Hypothesis]:
    torque, reference = declared.record.torque, declared.record.reference
    assert torque is not None
    assert reference is not None
    if len(torque) == len(reference):
        swapped = {
            "torque": replace(torque, values=reference.values),
            "reference": replace(reference, values=torque.values),
        }
        yield replace(declared, record=declared.record.with_channels(swapped))


SWAPPED_CHANNELS = Fault(
    "swapped_channels", "swapped channels", correct=_swap_channels, clause="torque and reference are swapped"
)


def with_cutoffs(filtering: Filtering, factor: float) -> Filtering:
    """Return a resolved filtering with its cut-offs so many times as high."""
    assert filtering.cutoff is not None
    assert filtering.position_cutoff is not None
    return replace(filtering, cutoff=factor * filtering.cutoff, position_cutoff=factor * filtering.position_cutoff)


def _try_sample_times(declared: Hypothesis) -> Iterator[Hypothesis]:
    if getattr(declared.controller, "period", None) is not None:
        return  # a controller with a period of its own contradicts a wrong sample time before anything is simulated
    for factor in _TIMES:
        channels = {n: replace(c, sample_time=factor * c.sample_time) for n, c in declared.record.items()}
        yield replace(
            declared,
            record=declared.record.with_channels(channels),
            filtering=with_cutoffs(declared.filtering, 1 / factor),
            factor=factor,
        )


def _explain_sample_time(value: float | None, loop: ClosedLoop) -> Iterator[Meaning]:
    assert value is not None
    yield SAMPLE_TIME, f"the sample time is {say_times(value)} too {'short' if value > 1 else 'long'}", value
    if "velocity_gain" in numbers_of(loop.controller):
        # u = g (Kv e - v): with all velocities f times as large it is the law with Kv f times as large, and g f times
        # as small. Only filters and delays tell the two apart, hardly.
        yield LAW_GAIN, "position gain and torque (or velocity gain) are both off by that factor", None


SAMPLE_TIME = Fault(
    "sample_time", "sample time", correct=_try_sample_times, meanings=_explain_sample_time, must_leave=_BY_TIME
)


# Causes that are judged by a problem of their own


def _judge_motion(declared: Hypothesis, best: Fit | None, _: float) -> tuple[float | None, float] | None:
    """Return the residual if the reference is the motor's position; None if it cannot be.

    The motion of a flexible joint is prescribed then, and not compared at rest. Its residual is scaled to that of the
    other causes by the residuals of the best of them under both measures.
    """
    record, joint = declared.record, declared.loops[0].joint
    assert record.torque is not None
    moved = replace(record, motor_position=record.reference, load_position=None)
    try:
        if not isinstance(joint, FlexibleJoint):
            return None, identify_record(moved, joint, IDIM(), filtering=declared.filtering).fit.filtered_error
        delay = log_delay(None, record.torque.sample_time)
        problem = motion_problem(moved, DriveSide(joint), declared.filtering, joint.parameters, delay)
        start = grid_starts(problem, None)[0][0]
        solution = follow(problem, start, MORE)
    except (JointidError, np.linalg.LinAlgError):
        return None
    left = float(np.linalg.norm(solution.residual)) / problem.size
    if best is None or best.problem.measured.size != problem.measured.size:
        return None, left
    measured = best.problem.measured
    other, size = (problem.filter(one) for one in (measured - best.problem.torque(best.x), measured))
    return None, left * best.error * float(np.linalg.norm(size) / np.linalg.norm(other))


REFERENCE_IS_POSITION = Fault(
    "reference_is_position", "position as reference", judge=_judge_motion,
    clause="the channel given as the reference is the motor's actual position",
    # Its response is the controller's, too, which it explains whatever the controller does.
    more_than_responses=2.0,
)  # fmt: skip


def _judge_mode(declared: Hypothesis, _: Fit | None, least: float) -> tuple[float | None, float] | None:
    """Return the mode that explains a record of a rigid joint clearly better than any other cause; else None.

    The additional parameters absorb a part of other causes, so an equal residual is not enough.
    """
    rigid = declared.loops[0].joint
    if not isinstance(rigid, RigidJoint):
        return None
    loop = replace(declared.loops[0], joint=rigid.flexible)
    try:
        found = next(iter(fit_flexible((replace(declared, loops=(loop,)),), loop)), None)
    except (JointidError, np.linalg.LinAlgError):  # the other causes stand
        return None
    if found is None or found.error * _FLEXIBLE > least:
        return None
    values = found.values
    if not all(values[name] > 0 for name in ("motor_inertia", "load_inertia", "stiffness")):
        return None
    return FlexibleJoint.frequencies(values)["free_free"], found.error


FLEXIBLE = Fault(
    "flexible", "flexible joint", judge=_judge_mode,
    clause='the joint is flexible (model = "flexible"), with a mode near {value} Hz',
)  # fmt: skip

FAULTS = (TORQUE_SIGN, REFERENCE_SIGN, SWAPPED_CHANNELS, SAMPLE_TIME, REFERENCE_IS_POSITION, FLEXIBLE)
