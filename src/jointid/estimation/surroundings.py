"""What surrounds a joint and may be as unknown as the joint itself: its first state, its loop, its drive, its log.

A problem keeps these at what the record and the joint file say, unless they are made free. Each is a `Parameter` that
stands beside those of the joint:

- ``initial_position``, ``initial_velocity`` of the motor at the first sample;
- any number of the controller, by its own name: ``kp``, ``kv``, ``kd``, ``delay``, ``limit``;
- ``drive_gain``: the torque that acts, over the torque in the log. One record cannot tell it from the scale of the
  joint; a known mass can;
- ``log_gain``: the torque in the log, over the torque the law put out: log and law disagree;
- ``log_delay``: how much later than its stamps the torque channel shows the torque.
"""

from __future__ import annotations

import math
from dataclasses import replace

from jointid.common.errors import MethodError
from jointid.model.controllers import Controller
from jointid.model.parameters import Parameter, Quantity
from jointid.simulation.experiment import ClosedLoop

INITIAL_STATE = (
    Parameter("initial_position", "q(0)", Quantity.POSITION),
    Parameter("initial_velocity", "v(0)", Quantity.VELOCITY),
)
"""The motor's state at the first sample; an axis may already move when the log begins."""

DRIVE_GAIN = Parameter("drive_gain", "g", Quantity.RATIO, free=False, start=1.0, lower=1e-3)
LOG_GAIN = Parameter("log_gain", "g log", Quantity.RATIO, free=False, start=1.0, lower=1e-3)
LOG_DELAY = Parameter("log_delay", "d log", Quantity.TIME, free=False, start=0.0)

_DRIVE_AND_LOG = {p.name: p for p in (DRIVE_GAIN, LOG_GAIN, LOG_DELAY)}
_INITIAL = {p.name: p for p in INITIAL_STATE}


def surrounding(name: str, controller: Controller) -> Parameter:
    """Return the parameter of that name, free, starting at what is declared.

    Raises:
        MethodError: nothing around a joint has that name; the sentence says what has one.
    """
    if name in _INITIAL:
        return _INITIAL[name]
    if name in _DRIVE_AND_LOG:
        return replace(_DRIVE_AND_LOG[name], free=True)
    value = getattr(controller, name, None)
    if name == "period" or isinstance(value, bool) or not isinstance(value, float | int):
        known = ", ".join((*_INITIAL, *_DRIVE_AND_LOG, *numbers_of(controller)))
        raise MethodError(f'Nothing around this joint is called "{name}"; what can be freed is {known}.')
    if not math.isfinite(value):
        raise MethodError(f"The {name} of this controller is {value}, where no search can begin; declare a finite one.")
    quantity = Quantity.TIME if name == "delay" else Quantity.GAIN
    return Parameter(name, name, quantity, start=float(value), lower=0.0)


def numbers_of(controller: Controller) -> tuple[str, ...]:
    """Return the names of a controller's numbers that can be parameters: its gains, its limit and its delay."""
    names = getattr(type(controller), "__dataclass_fields__", {})
    values = {name: getattr(controller, name) for name in names if name != "period"}
    return tuple(n for n, v in values.items() if isinstance(v, float | int) and not isinstance(v, bool))


def of_law(name: str) -> bool:
    """Whether a parameter of a problem that is not the joint's belongs to the controller."""
    return name not in _INITIAL and name not in _DRIVE_AND_LOG


def with_numbers(loop: ClosedLoop, numbers: dict[str, float]) -> ClosedLoop:
    """Return the loop with other numbers in its controller."""
    controller: Controller = replace(loop.controller, **numbers)  # type: ignore[type-var]
    return replace(loop, controller=controller)
