"""Numbers of the controller, and the gain and the delay of the log.

A gain or a time of the controller that is off by little is tested by its exact derivative. One that is off by much is
free in a hypothesis, and the search begins at multiples of what is declared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.diagnostics.faults.fault import Fault, Hypothesis, Measure, call_number, name_number
from jointid.diagnostics.seen import Columns, Seen
from jointid.models.controllers import FirstOrder, numbers_of, with_numbers
from jointid.models.joints import ClosedLoop

_DEGREES = 180 / math.pi
_GAINS = (1e-3, 1 / _DEGREES, 0.1, 0.3, 0.6, 1.6, 3.0, 10.0, _DEGREES, 1e3)  # times a declared gain, units among them
_INTEGRALS = (1e-3, 0.01, 0.1, 0.5, 2.0, 10.0, 100.0, 1e3)  # times a declared gain: its time may be in ms, read in s
_NEW_INTEGRALS = (1.0, 10.0, 100.0)  # 1/s, of what they act beside, where none is declared
_LATE = (1.0, 3.0, 8.0)  # periods of a delay or a filter
_HARDLY = 0.1  # periods: a filter or a delay that is off by less is none
_STEP = 1e-4  # of the known signal
_SMALL = math.log(1.5)  # a number that is off by less is left to its test, which gives an interval
_TIME = "velocity_filter.time_constant"
_IS_ABOUT = "{name} is about {shown}, not {declared}"


def is_small_factor(value: float | None, *_: object) -> bool:
    """Return True if a factor is so near to 1 that it is no cause."""
    return value is not None and value > 0 and abs(math.log(value)) < _SMALL


def _is_near(name: str, value: float | None, loop: ClosedLoop, period: float) -> bool:
    """Test whether a number is so near to what is declared that it is no cause: a time, or a gain."""
    declared = numbers_of(loop.controller).get(name, 0.0)
    if value is None:
        return False
    if name.endswith("gain"):
        return declared > 0 and is_small_factor(value / declared)
    # A first order in the place of taps is no small change.
    taps = name == _TIME and getattr(loop.controller, "velocity_filter", None) not in ((1.0,), None)
    return (declared > 0 or not taps) and abs(value - declared) < _HARDLY * period


def _try_number(name: str, times: Sequence[float], declared: Hypothesis) -> Iterator[Hypothesis]:
    if value := declared.numbers.get(name):
        yield declared.starting_at(name, [factor * value for factor in times])


def _try_integral(declared: Hypothesis) -> Iterator[Hypothesis]:
    numbers = declared.numbers
    yield from _try_number("integral_gain", _INTEGRALS, declared)
    if numbers.get("integral_gain"):
        yield declared.under([replace(declared.controller, integral_gain=0.0)])
    elif "integral_gain" in numbers:
        unit = 1.0 if "velocity_gain" in numbers else numbers["position_gain"]
        yield declared.starting_at("integral_gain", [one * unit for one in _NEW_INTEGRALS])


def _try_delay(name: str, declared: Hypothesis) -> Iterator[Hypothesis]:
    if name in declared.numbers:
        yield declared.starting_at(name, [declared.numbers[name] + late * declared.period for late in _LATE])


def _swap_gains(declared: Hypothesis) -> Iterator[Hypothesis]:
    numbers = declared.numbers
    other = "velocity_gain" if "velocity_gain" in numbers else "derivative_gain"
    if numbers.get("position_gain") and numbers.get(other):
        gains = {"position_gain": numbers[other], other: numbers["position_gain"]}
        yield declared.under([with_numbers(declared.controller, gains)])


def _filters(declared: Hypothesis) -> list[FirstOrder]:
    return [FirstOrder(late * declared.period) for late in _LATE]


def _try_velocity_filter(declared: Hypothesis) -> Iterator[Hypothesis]:
    law = declared.controller
    if hasattr(law, "velocity_filter"):
        yield declared.under([replace(law, velocity_filter=one) for one in _filters(declared)], _TIME)
        yield declared.under([replace(law, velocity_filter=(1.0,))])


def _try_torque_filter(declared: Hypothesis) -> Iterator[Hypothesis]:
    law = declared.controller
    if hasattr(law, "torque_filters"):
        more = [replace(law, torque_filters=(one, *law.torque_filters)) for one in _filters(declared)]
        yield declared.under(more, "torque_filters.0.time_constant")


def _try_feedforward(declared: Hypothesis) -> Iterator[Hypothesis]:
    law, numbers = declared.controller, declared.numbers
    if "velocity_feedforward" in numbers:
        ahead = 0.0 if numbers["velocity_feedforward"] else 1.0
        yield declared.under([replace(law, velocity_feedforward=ahead)])
    elif hasattr(law, "reference_velocity"):
        read = "difference" if law.reference_velocity == "none" else "none"
        yield declared.under([replace(law, reference_velocity=read)])


def _late(seen: Seen) -> Columns:
    if seen.loop is None:  # of a loop its derivative is exact
        yield None, -np.gradient(seen.torque, seen.sample_time)


def _scale_injected(seen: Seen) -> Columns:
    """Yield the change by the injected signal's gain, where the signal is added after the limit."""
    if seen.loop is None or not np.any(seen.loop[0].axis.after_limit):
        return
    problem, x = seen.loop

    def scale(by: float) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=by * e.after_limit, logged=by * e.logged))

    yield None, (scale(1 + _STEP) - scale(1 - _STEP)) / (2 * _STEP)


def _number(name: str) -> Fault:
    return Fault(name, name_number(name), call_number(name), declared=None)


def _gain(name: str) -> Fault:
    return replace(
        _number(name), correct=partial(_try_number, name, _GAINS), clause=_IS_ABOUT,
        negligible=partial(_is_near, name),
    )  # fmt: skip


VELOCITY_FILTER = Fault(
    "velocity_filter", "velocity filter", "the velocity filter", correct=_try_velocity_filter,
    clause="the velocity filter is another one, such as one of first order with {shown}",
    negligible=partial(_is_near, _TIME),
)  # fmt: skip
TORQUE_FILTER = Fault(
    "torque_filter", "torque filter", correct=_try_torque_filter,
    clause="there is one more torque filter, such as one of first order with {ms} ms", negligible=partial(_is_near, ""),
)  # fmt: skip
DELAY = Fault(
    "delay", "delay of the torque", "the delay", "the torque reacts {size} {sense} than declared",
    ("later", "earlier"), declared=None, measure=Measure.TIME, correct=partial(_try_delay, "delay"), clause=_IS_ABOUT,
    negligible=partial(_is_near, "delay"),
)  # fmt: skip
REFERENCE_DELAY = replace(
    _number("reference_delay"), measure=Measure.TIME, correct=partial(_try_delay, "reference_delay"),
    clause="the law sees the reference about {ms} ms late", negligible=partial(_is_near, "reference_delay"),
)  # fmt: skip
LOG_DELAY = Fault(
    "log_delay", "delay of the log", "the log delay", "the logged torque is {size} {sense} than its time stamps say",
    ("later", "earlier"), columns=_late, declared=None, measure=Measure.TIME,
)  # fmt: skip
LOG_GAIN = Fault("log_gain", "size of the logged torque", "the logged torque", declared=None)
INJECTED_GAIN = Fault(
    "injected_gain", "size of the injected signal", "the injected signal", columns=_scale_injected, declared=1.0,
    last=True,
)  # fmt: skip
SWAPPED_GAINS = Fault(
    "swapped_gains", "swapped gains", correct=_swap_gains,
    clause="position gain and velocity (or derivative) gain are swapped",
)  # fmt: skip

FAULTS = (
    _gain("position_gain"), _gain("derivative_gain"), SWAPPED_GAINS,
    replace(_gain("integral_gain"), correct=_try_integral), VELOCITY_FILTER, TORQUE_FILTER,
    replace(
        _number("velocity_feedforward"), correct=_try_feedforward,
        clause="the velocity feed-forward is there and not declared, or the other way round",
    ),
    DELAY, REFERENCE_DELAY, replace(_number("gain"), title="gain of the controller's output", last=True), LOG_GAIN,
    LOG_DELAY, INJECTED_GAIN,
)  # fmt: skip
_BY_NAME = {one.name: one for one in FAULTS}


@cache
def number_fault(name: str) -> Fault:
    """Return the fault of a number of the controller or the log that is not as declared."""
    return _BY_NAME.get(name) or _number(name)
