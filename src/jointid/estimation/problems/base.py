"""The base of every problem: its parameters by name and as a vector, what it is measured against, and sums of problems.

What surrounds a joint may be as unknown as the joint itself: its first state, its loop, its drive, its log. A problem
keeps these at what the record and the joint file say, unless they are made free (`surrounding`). Each is a `Parameter`
that stands beside those of the joint:

- ``initial_position``, ``initial_velocity`` of the motor at the first sample;
- ``initial_torque`` there of a controller with an integral, which holds what friction and gravity ask for;
- any number of the controller, by its own name: ``position_gain``, ``velocity_gain``, ``derivative_gain``,
  ``delay``, ``limit``, and those of its filters, as ``velocity_filter.time_constant`` or
  ``torque_filters.0.frequency``;
- ``drive_gain``: the torque that acts, over the torque in the log. One record cannot tell it from the scale of the
  joint; a known mass can;
- ``log_gain``: the torque in the log, over the torque the law put out: log and law disagree;
- ``log_delay``: how much later than its stamps the torque channel shows the torque.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.models.controllers import LONGEST_DELAY, Controller, numbers_of
from jointid.models.joints import Joint
from jointid.records.signals.filtering import Filtering

INITIAL_STATE = (
    Parameter("initial_position", "q(0)", Quantity.POSITION),
    Parameter("initial_velocity", "v(0)", Quantity.VELOCITY),
)
"""The motor's state at the first sample; an axis may already move when the log begins."""

DELAY = "delay"
"""The number of a controller by which its torque acts later than it is put out."""

DELAYS = (0.0, 0.003, 0.006, 0.009)
"""Seconds, of drives and their buses: where the search for a delay begins."""

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
_LEFT_OPEN = 2.0  # samples: an averaged torque acts one sooner than a held one
_INITIAL = {p.name: p for p in INITIAL_STATE}
_PARTS = ("integral_gain", "time_constant")  # numbers that are a part of the law: at 0 it is not there
_POSITIVE = ("gain", "limit", "velocity_limit", "frequency", "bandwidth", "damping", "numerator_frequency")
_ROOM = 1e-3  # below what a law cannot have: a derivative by differences also evaluates outside the value
_SMALL = 1e-6  # relative: how near a search comes to what a law cannot have


def adjust_parameters(parameters: Iterable[Parameter], changes: Mapping[str, Parameter]) -> tuple[Parameter, ...]:
    """Replace the parameters named in `changes`."""
    parameters = tuple(parameters)
    names = [parameter.name for parameter in parameters]
    for name, change in changes.items():
        if name not in names or not isinstance(change, Parameter):
            raise MethodError(
                f"This model has the parameters {', '.join(names)}; received {name} = {change!r}: change its own, by "
                "fix(value) or dataclasses.replace."
            )
    return tuple(changes.get(parameter.name, parameter) for parameter in parameters)


def surrounding(name: str, controller: Controller, period: float | None = None) -> Parameter:
    """Return the named parameter, free, from its declared value, within the law's bounds.

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


def log_delay(known: float | None, sample_time: float, *, stated: bool = True) -> Parameter:
    """Return the log's delay as it is known, in seconds; where it is None free, within twenty samples.

    It counts from when the torque acts. Where the torque's timing is not stated, a known delay is free within two.
    """
    late, start = sample_time * (_MOST_LATE if known is None else _LEFT_OPEN), known or 0.0
    free = replace(LOG_DELAY, free=True, start=start, lower=start - late, upper=start + late)
    return free if known is None or not stated else free.fix(known)


def _range(symbol: str, value: float, period: float | None) -> tuple[float, float]:
    """Return the bounds of a number of a law."""
    lower = {"constant_feedforward": -math.inf, "numerator_damping": -1.0 + _SMALL}.get(symbol, 0.0)
    if symbol in _POSITIVE:
        lower = _SMALL * value
    upper = math.inf
    if period is not None and symbol.endswith("frequency"):
        upper = max((0.5 - _ROOM) / period, value)
    elif period is not None and symbol == "reference_delay":
        upper = max((1.0 - _ROOM) * LONGEST_DELAY * period, value)
    return lower, upper


def of_law(name: str) -> bool:
    """Test whether a surrounding parameter belongs to the controller."""
    return name not in INITIAL and name not in DRIVE_AND_LOG


# The problems

FAILED = 1e3  # times the measured signal: the error of a candidate that cannot be simulated


@dataclass(frozen=True, slots=True, eq=False)
class RecordProblem:
    """A record and a model of it: free parameters in, the filtered error out; the base of a `solvers.solve.Problem`.

    Attributes:
        parameters: all of the joint, then of what surrounds it.
        measured: (samples,) what is reproduced, raw.
        filtering: resolved.
    """

    parameters: tuple[Parameter, ...]
    measured: FloatArray
    filtering: Filtering

    if TYPE_CHECKING:

        @property
        def joint(self) -> Joint:
            """The joint."""

        @property
        def sample_time(self) -> float:
            """Of the measured signal, seconds."""

        def filter(self, columns: FloatArray) -> FloatArray:
            """Return signals, (samples,) or (samples, columns), through the problem's own filter, decimated."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return tuple(p for p in self.parameters if p.free)

    @property
    def free_joint(self) -> tuple[Parameter, ...]:
        """Those of them that belong to the joint; they come first."""
        own = {p.name for p in self.joint.parameters}
        return tuple(p for p in self.free if p.name in own)

    @property
    def units(self) -> dict[str, str]:
        """Of every parameter, by name."""
        return {p.name: self.joint.unit(p) for p in self.parameters}

    @property
    def size(self) -> float:
        """Norm of the filtered signal: what a residual is measured against."""
        return float(np.linalg.norm(self.filter(self.measured)))

    def filtered_error(self, error: FloatArray) -> float:
        """Return the norm of a filtered error, (rows,), over that of the filtered signal, a ratio."""
        return float(np.linalg.norm(error) / self.size)

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter by name, the fixed ones too."""
        found = dict(zip((p.name for p in self.free), map(float, x), strict=True))
        return {p.name: found.get(p.name, float(p.start or 0.0)) for p in self.parameters}

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the free parameters of `values`, in order; one that is not there starts as declared."""
        return np.array([values.get(p.name, p.start or 0.0) for p in self.free])

    def replace_parameters(self, changes: Mapping[str, Parameter]) -> Self:
        """Return the problem with the parameters of these names replaced; others are not added."""
        return replace(self, parameters=tuple(changes.get(p.name, p) for p in self.parameters))

    def keeping(self, values: Mapping[str, float]) -> Self:
        """Return the problem with parameters fixed at these values, by name; others are not added."""
        return self.replace_parameters({p.name: p.fix(values[p.name]) for p in self.parameters if p.name in values})

    def all_free(self) -> Self:
        """Return the problem with every parameter free, so that every derivative is there."""
        return self.replace_parameters({p.name: replace(p, free=True) for p in self.parameters})
