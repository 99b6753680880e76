"""Faults of the record: signs, swapped channels, the sample time, a motion in the place of the reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jointid.common.errors import JointidError
from jointid.diagnostics.faults.fault import Fault, Hypothesis, Meaning, Shown
from jointid.diagnostics.faults.loop_gain import LAW_GAIN, say_times
from jointid.diagnostics.hypothesis_fits import MORE, Fit, fit_flexible, follow
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.prescribed import DriveSideFit, grid_starts
from jointid.estimation.problems.prescribed import motion_problem
from jointid.models.controllers import numbers_of
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide

_TIMES = (0.1, 0.125, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 8.0, 10.0)  # times the sample time: rates that drives log at
_BY_TIME = 0.6  # of the declared error: a sample time that is wrong by a factor spoils all of a fit
_FLEXIBLE = 2.0  # times: what a mode takes away; of a friction that no model has its parameters take a third at most


def _turn_torque(declared: Hypothesis) -> Iterator[Hypothesis]:
    torque = declared.record.torque
    assert torque is not None
    turned = {"torque": replace(torque, values=-torque.values)}
    yield replace(declared, record=declared.record.with_channels(turned))


REFERENCE_SIGN = Fault("reference_sign", "sign of the reference")


def _explain_sign(*_: object) -> Iterator[Meaning]:
    """Yield both signs: turned round, they differ only in the sign of the joint's position."""
    yield TORQUE_SIGN, "the torque has the wrong sign", None
    yield REFERENCE_SIGN, "the reference has the wrong sign", None


TORQUE_SIGN = Fault("torque_sign", "sign of the torque", correct=_turn_torque, meanings=_explain_sign)


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


def _explain_sample_time(value: float | None, loop: ClosedLoop, _: Shown) -> Iterator[Meaning]:
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
    """Return what is left if the reference is the motor's position; None where that cannot be.

    A flexible joint's motion is prescribed then, and what it does at rest is not compared; what is left is brought to
    the measure of the other causes by what the best of them leaves in both.
    """
    record, joint, settings = declared.record, declared.loops[0].joint, DriveSideFit()
    assert record.torque is not None
    moved = replace(record, motor_position=record.reference, load_position=None)
    try:
        if not isinstance(joint, FlexibleJoint):
            return None, identify_record(moved, joint, IDIM(), filtering=declared.filtering).fit.filtered_error
        around = settings.surroundings(record.torque.sample_time)
        problem = motion_problem(moved, DriveSide(joint), declared.filtering, joint.parameters, around)
        start = grid_starts(problem, settings)[0][0]
        solution = follow(problem, start, MORE)
    except (JointidError, np.linalg.LinAlgError):
        return None
    left = float(np.linalg.norm(solution.residual)) / problem.size
    if best is None or best.problem.measured.size != problem.measured.size:
        return None, left
    measured = best.problem.measured
    other, size = (problem.filtered(one) for one in (measured - best.problem.torque(best.x), measured))
    return None, left * best.error * float(np.linalg.norm(size) / np.linalg.norm(other))


REFERENCE_IS_POSITION = Fault(
    "reference_is_position", "position as reference", judge=_judge_motion,
    clause="the channel given as the reference is the motor's actual position",
    # Its response is the controller's, too, which it explains whatever the controller does.
    more_than_responses=2.0, doubt="more than one thing is wrong with the controller",
)  # fmt: skip


def _judge_mode(declared: Hypothesis, _: Fit | None, least: float) -> tuple[float | None, float] | None:
    """Return the mode that explains a record of a rigid joint clearly better than any other cause; else None.

    Its further parameters make up for a part of other causes, so as good as they is not enough.
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
