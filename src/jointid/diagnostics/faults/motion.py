"""Records whose motion tells too little: too short, one way only, or hardly any motion.

A record that is too short, or that moves one way only, fits many drives: the Coulomb friction and the offset are one
number then, and a factor of thousands explains it as well as none. An axis hardly moves where its friction holds it, or
where its own disturbances make more than the reference asks.

While a motor stands still its controller sees the whole reference as an error, so that the torque is what the law makes
of the reference alone; that is simulated with a mass that nothing moves. A torque that is just this is of an axis at
rest. And where most of a torque is no response to the reference at all, though even at rest the reference would make
no more, the motion is lost in what else disturbs the axis.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.diagnostics.faults.forces import find_steps
from jointid.diagnostics.linear_response import SHORTEST
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.records.checks import find_encoder_step
from jointid.records.record import Channel, Record
from jointid.simulation.closed_loop import simulate
from jointid.simulation.loop_input import prepare
from jointid.uncertainty.verdict import Reason

_IMMOVABLE = 1e20  # kg or kg m2
_FEW_STEPS = 20.0  # of an encoder, in all: fewer are no motion to a controller that sees them
_AS_AT_REST = 0.15  # of the torque's scatter: so little is left where it is that of an axis at rest
_SAME_SIZE = 0.25  # so near to 1 is then its size
_LOST = 0.3  # of the torque, that is no response to the reference
_AS_LARGE = 0.5  # of what the reference would make at rest: axes that move make a sixth of it at most
_REMEDY = "record a larger or faster motion"
_LEAST = 1.0  # s of motion: a shorter record is not relied on
_BACK = 0.05  # of all the way: who goes back less moves one way only


def find_plain_cause(record: Record) -> Message | None:
    """Return what the samples of torque and reference show without a simulation; None where they show nothing.

    Args:
        record: with torque and reference.
    """
    assert record.reference is not None
    if record.injected is not None:  # that moves the joint, too
        return None
    return _too_short(record.reference, SHORTEST, "to tell what is wrong") or find_steps(record)


def find_too_short(record: Record) -> Message | None:
    """Return that a record is too short for a value to be relied on, however well it fits; None where it is not.

    A motion one way has no reversal, so that a constant force stands for the Coulomb friction, and a short one leaves
    many parameters to few rows.
    """
    if record.reference is None or record.injected is not None:
        return None
    return _too_short(record.reference, _LEAST, "to rely on")


def _too_short(reference: Channel, needed: float, what_for: str) -> Message | None:
    """Return that a record is too short, and how long would do; None where it is long enough."""
    change = np.diff(reference.values)
    (moving,) = np.nonzero(change)
    seconds = reference.sample_time * (change.size + 1 - moving[0]) if moving.size else 0.0
    there, back = float(np.sum(change[change > 0])), float(-np.sum(change[change < 0]))
    both_ways = min(there, back) > _BACK * max(there, back)
    if both_ways and seconds >= needed:
        return None
    if seconds >= needed:
        clause = f"the record has motion one way only, which is too little {what_for}; there and back would do"
    else:
        lasts = f"it has {number(seconds, 2)} s of motion{'' if both_ways else ', one way only'}"
        clause = f"the record is too short {what_for}: {lasts}; {SHORTEST:g} s or more, both ways, would do"
    return Message(Reason.RECORD_TOO_SHORT, clause, {"seconds": seconds, "needed": SHORTEST}, clause)


def find_standstill(record: Record, loop: ClosedLoop) -> Message | None:
    """Return that an axis hardly moves, and by how much, as its motor's position or its torque shows; else None.

    Args:
        record: with torque and reference.
        loop: as it is declared; of a law that is declared wrong the torque shows nothing.
    """
    if record.injected is not None:  # that moves the joint, too
        return None
    return _seen_by_motor(record) or _seen_by_torque(record, loop)


def find_lost_motion(record: Record, loop: ClosedLoop, unexplained: float) -> Message | None:
    """Return that a motion is too small beside what disturbs the axis, where no cause explains its torque; else None.

    Args:
        record: with torque and reference.
        loop: as it is declared.
        unexplained: share of the torque that is no response to the reference.
    """
    both = None if record.injected is not None else _torques(record, loop, integral=False)
    if both is None or unexplained < _LOST or np.std(both[0]) < _AS_LARGE * np.std(both[1]):
        return None
    return _hardly(
        f"the reference travels {_travel(record)} in all, and {number(100 * unexplained, 2)} % of the torque is no "
        "response to it"
    )


def _seen_by_motor(record: Record) -> Message | None:
    motor = record.motor_position
    if motor is None:
        return None
    # Beside the reference its travel would say nothing: that may be in other units, or another channel.
    moved, step = float(np.ptp(motor.values)), find_encoder_step(motor)
    steps = moved / step if step else 0.0
    if steps > _FEW_STEPS or (moved and not step):
        return None
    counted = f", {steps:.0f} steps of its encoder," if steps else ""
    return _hardly(f"the motor moves by {number(moved, 2)} {motor.unit}{counted} where {_travel(record)} are asked")


def _seen_by_torque(record: Record, loop: ClosedLoop) -> Message | None:
    both = _torques(record, loop)
    if both is None:
        return None
    torque, at_rest = both
    size = float(np.linalg.norm(torque - torque.mean()))
    # Where the motor stands is not known, and an integral sums that up.
    columns = np.column_stack([at_rest, np.ones(torque.size), np.linspace(0.0, 1.0, torque.size)])
    share = np.linalg.lstsq(columns, torque, rcond=None)[0]
    left = float(np.linalg.norm(torque - columns @ share))
    if not (left < _AS_AT_REST * size and abs(share[0] - 1.0) < _SAME_SIZE):
        return None
    moved = max(abs(float(share[0]) - 1.0), left / size)
    words = (
        f"with the motor at rest the controller would make all of this torque but {number(100 * left / size, 2)} %, "
    )
    words += f"so that it moves {number(100 * moved, 2)} % at most of the {_travel(record)} that are asked"
    return _hardly(words)


def _torques(record: Record, loop: ClosedLoop, *, integral: bool = True) -> tuple[FloatArray, FloatArray] | None:
    """Return the torque, and what it would be with the motor at rest, (samples,) each; None where no loop is simulated.

    `integral` says whether the law keeps one, which at rest has no end.
    """
    law: Any = loop.controller
    law = law if integral or not getattr(law, "integral_gain", 0.0) else replace(law, integral_gain=0.0)
    joint = loop.joint.rigid if isinstance(loop.joint, FlexibleJoint) else loop.joint
    still = ClosedLoop(joint, law)
    values = dict.fromkeys((p.name for p in joint.parameters), 0.0) | {"inertia": _IMMOVABLE}
    try:
        with np.errstate(all="ignore"):
            at_rest = simulate(still, prepare(still, record), values).torque
    except JointidError:
        return None
    assert record.torque is not None
    count = min(at_rest.size, record.torque.values.size)
    torque, at_rest = record.torque.values[:count], at_rest[:count]
    return (torque, at_rest) if np.all(np.isfinite(at_rest)) and np.ptp(torque) and np.ptp(at_rest) else None


def _travel(record: Record) -> str:
    assert record.reference is not None
    return f"{number(float(np.ptp(record.reference.values)), 2)} {record.reference.unit}"


def _hardly(words: str) -> Message:
    clause = f"the axis hardly moves: {words}; {_REMEDY}"
    return Message(Reason.HARDLY_MOVES, clause, {}, clause)
