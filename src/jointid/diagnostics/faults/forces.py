"""Steps of a torque that nobody asked for: a signal is injected that is not declared."""

from __future__ import annotations

from typing import Any

import numpy as np

from jointid.common.messages import Message
from jointid.common.text import pluralise
from jointid.estimation.result.verdict import Reason
from jointid.records.record import Record

_FEWEST = 12  # steps of an injected signal
_CLEAR = 10.0  # times the median change of a sample: size of a step
_LARGE = 0.03  # of the torque's scatter: a smaller step is of no interest
_ALONE = 0.3  # of a step: so much the samples before and after it may change
_ROUNDED = 5  # times the smallest change of a sample, which is that of its rounding
_RESTS, _OFTEN = 1e-3, 0.02  # of the greatest speed, and of the samples: where a reference asks for nothing
_AS_OFTEN = 1 / 3  # as all over the record they are where the reference rests, if it does
_OWN = 0.5  # of their squares: so much of the steps is none of the reference's velocity, acceleration and direction


def find_steps(record: Record) -> Message | None:
    """Return the message of an undeclared injected signal, if the torque has steps of its own; else None.

    A step is a change in one sample between two without a change. Steps of a controller that is slower than the log,
    or of a stepped reference, correlate with the reference, and stop while it rests.
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
    bound = max(_CLEAR * float(np.median(change)), _ROUNDED * rounding, _LARGE * float(np.std(torque.values)))
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
        f"a signal is injected that is not declared (channel injected): the torque makes {pluralise(count, 'step')} "
        "that the reference does not ask for"
    )
    values: dict[str, Any] = {"causes": [{"cause": "injected", "value": count, "error": None}]}
    return Message(Reason.CAUSE_FOUND, clause, values, clause)
