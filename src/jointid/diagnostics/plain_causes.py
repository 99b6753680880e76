"""What is wrong with a record and is plain from its samples: no drive has to be simulated to say it.

A record that is too short, or that moves one way only, fits many drives: the Coulomb friction and the offset are one
number then, and a factor of thousands explains it as well as none. And a torque that steps where the reference asks
for nothing, and stays there, is another signal's: what was injected, and not declared.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jointid.common.messages import Message
from jointid.common.text import counted, number
from jointid.diagnostics.hypotheses import Cause
from jointid.diagnostics.linear_response import SHORTEST
from jointid.records.record import Channel, Record
from jointid.uncertainty.verdict import Reason

_LEAST = 1.0  # s of motion: a shorter record is not relied on
_BACK = 0.05  # of all the way: who goes back less moves one way only
_STEP = 10.0  # times the median change of a sample: so large is a step
_LARGE = 0.03  # of the torque's scatter: a smaller step is of no interest
_ALONE = 0.3  # of a step: so much the samples before and after it may change
_ROUNDED = 5  # times the smallest change of a sample, which is that of its rounding
_RESTS, _OFTEN = 1e-3, 0.02  # of the greatest speed, and of the samples: where a reference asks for nothing
_FEWEST = 12  # steps
_AS_OFTEN = 1 / 3  # as all over the record they are where the reference rests, if it does
_OWN = 0.5  # of their squares: so much of the steps is none of the reference's velocity, acceleration and direction


def find_plain_cause(record: Record) -> Message | None:
    """Return what is plain from the samples of torque and reference; None where nothing is.

    Args:
        record: with torque and reference.
    """
    assert record.torque is not None
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


def find_steps(record: Record) -> Message | None:
    """Return that a signal is injected that is not declared, where the torque makes steps of its own; else None.

    A step is a change in one sample between two in which hardly anything changes; those of a controller that runs
    slower than the log, or of a reference in steps, follow from the reference, and are not there where that rests.
    """
    torque, reference = record.torque, record.reference
    assert torque is not None
    assert reference is not None
    if record.injected is not None or torque.values.size < 2 * _FEWEST:
        return None
    signed = np.diff(torque.values)
    change = np.abs(signed)
    if not np.any(change):
        return None
    rounding = float(np.min(change[change > 0]))
    bound = max(_STEP * float(np.median(change)), _ROUNDED * rounding, _LARGE * float(np.std(torque.values)))
    here = change[1:-1]
    steps = (here > bound) & (np.maximum(change[:-2], change[2:]) < _ALONE * here)
    velocity = np.gradient(reference.values, reference.sample_time)
    asked = np.column_stack([velocity, np.gradient(velocity), np.sign(velocity)])
    asked = np.column_stack([np.interp(torque.time, reference.time, one)[1:-2] for one in asked.T])
    rests = np.abs(asked[:, 0]) < _RESTS * np.max(np.abs(velocity))
    count = int(np.sum(steps))
    if count < _FEWEST:
        return None
    if np.mean(rests) > _OFTEN and np.mean(steps[rests]) < _AS_OFTEN * np.mean(steps):
        return None
    sizes, by = signed[1:-1][steps], asked[steps] / np.maximum(np.max(np.abs(asked), axis=0), np.finfo(float).tiny)
    own = sizes - by @ np.linalg.lstsq(by, sizes, rcond=None)[0]
    if own @ own < _OWN * (sizes @ sizes):
        return None
    clause = (
        f"a signal is injected that is not declared (channel injected): the torque makes {counted(count, 'step')} that "
        "the reference does not ask for"
    )
    values: dict[str, Any] = {"causes": [{"cause": str(Cause.INJECTED), "value": count, "error": None}]}
    return Message(Reason.CAUSE_FOUND, clause, values, clause)
