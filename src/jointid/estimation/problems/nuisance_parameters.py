"""What surrounds a joint and may be as unknown as the joint itself: its first state, its loop, its drive, its log.

A problem keeps these at what the record and the joint file say, unless they are made free. Each is a `Parameter` that
stands beside those of the joint:

- ``initial_position``, ``initial_velocity`` of the motor at the first sample;
- ``initial_torque`` there of a controller with an integral, which holds what friction and gravity ask for;
- any number of the controller, by its own name: ``kp``, ``kv``, ``kd``, ``delay``, ``limit``, and those of its filters,
  as ``velocity_filter.time_constant`` or ``torque_filters.0.frequency``;
- ``drive_gain``: the torque that acts, over the torque in the log. One record cannot tell it from the scale of the
  joint; a known mass can;
- ``log_gain``: the torque in the log, over the torque the law put out: log and law disagree;
- ``log_delay``: how much later than its stamps the torque channel shows the torque.
"""

from __future__ import annotations

import math
from dataclasses import replace

from jointid.common.errors import MethodError
from jointid.models.controllers import LONGEST_DELAY, Controller, numbers_of
from jointid.models.parameters import Parameter, Quantity

INITIAL_STATE = (
    Parameter("initial_position", "q(0)", Quantity.POSITION),
    Parameter("initial_velocity", "v(0)", Quantity.VELOCITY),
)
"""The motor's state at the first sample; an axis may already move when the log begins."""

LOG_DELAY = Parameter("log_delay", "d log", Quantity.TIME, free=False, start=0.0)

DRIVE_AND_LOG = {
    "drive_gain": Parameter("drive_gain", "g", Quantity.RATIO, free=False, start=1.0, lower=1e-3),
    "log_gain": Parameter("log_gain", "g log", Quantity.RATIO, free=False, start=1.0, lower=1e-3),
    "log_delay": LOG_DELAY,
}
"""What lies between the joint's torque and the log's, by name."""

INITIAL_TORQUE = Parameter("initial_torque", "u(0)", Quantity.FORCE)
"""What a controller with an integral puts out at the first sample: what friction and gravity asked for until then."""

INITIAL = tuple(p.name for p in (*INITIAL_STATE, INITIAL_TORQUE))
"""Names of what belongs to a record's first sample, and to no other record."""

_MOST_LATE = 20.0  # samples that the log may be late, or early
_INITIAL = {p.name: p for p in INITIAL_STATE}
_PARTS = ("ki", "time_constant")  # numbers that are a part of the law: at 0 it is not there
_POSITIVE = ("gain", "limit", "velocity_limit", "frequency", "bandwidth", "damping", "numerator_frequency")
_BUFFERED = ("reference_delay", "velocity_feedforward_delay", "torque_feedforward_delay")
_ROOM = 1e-3  # below what a law cannot have: a derivative by differences looks beyond the number
_SMALL = 1e-6  # relative: how near a search comes to what a law cannot have


def surrounding(name: str, controller: Controller, period: float | None = None) -> Parameter:
    """Return the parameter of that name, free, starting at what is declared, within what a law can have.

    Args:
        name: of a part of the first state, the drive, the log, or a number of the controller.
        controller: whose numbers.
        period: of the controller, s; without it frequencies and delays have no upper bound.

    Raises:
        MethodError: nothing around a joint has that name; the sentence says what has one.
    """
    if name in _INITIAL:
        return _INITIAL[name]
    if name in DRIVE_AND_LOG:
        return replace(DRIVE_AND_LOG[name], free=True)
    numbers = numbers_of(controller)
    if name not in numbers:
        known = ", ".join((*_INITIAL, *DRIVE_AND_LOG, *numbers))
        raise MethodError(f'Nothing around this joint is called "{name}"; what can be freed is {known}.')
    value, symbol = numbers[name], name.rpartition(".")[2]
    if not math.isfinite(value):
        raise MethodError(f"The {name} of this controller is {value}, where no search can begin; declare a finite one.")
    if symbol in _PARTS and value == 0.0:
        raise MethodError(f"The {name} of this controller is 0, so it has no such part; declare a start above 0.")
    timed = symbol.endswith(("delay", "time_constant"))
    lower, upper = _range(symbol, value, period)
    quantity = Quantity.TIME if timed else Quantity.GAIN
    return Parameter(name, symbol, quantity, start=value, lower=lower, upper=upper)


def log_delay(known: float | None, sample_time: float) -> Parameter:
    """Return the log's delay as it is known, in seconds; where it is None free, within twenty samples."""
    late = _MOST_LATE * sample_time
    free = replace(LOG_DELAY, free=True, lower=-late, upper=late)
    return free if known is None else free.fixed(known)


def _range(symbol: str, value: float, period: float | None) -> tuple[float, float]:
    """Return the least and the largest number of that name that a law can have."""
    lower = {"constant_feedforward": -math.inf, "numerator_damping": -1.0 + _SMALL}.get(symbol, 0.0)
    if symbol in _POSITIVE:
        lower = _SMALL * value
    upper = math.inf
    if period is not None and symbol.endswith("frequency"):
        upper = max((0.5 - _ROOM) / period, value)
    elif period is not None and symbol in _BUFFERED:
        upper = max((1.0 - _ROOM) * LONGEST_DELAY * period, value)
    return lower, upper


def of_law(name: str) -> bool:
    """Whether a parameter of a problem that is not the joint's belongs to the controller."""
    return name not in INITIAL and name not in DRIVE_AND_LOG
