"""Numbers of the controller, and the gain and the delay of the log.

A gain or a time of the controller that is off by little is tested by its exact derivative. One that is off by much is
free in a hypothesis, and the search begins at multiples of what is declared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import number
from jointid.diagnostics.faults.fault import (
    MICROSECOND,
    Fault,
    Hypothesis,
    Measure,
    call_number,
    milliseconds,
    name_number,
    words,
)
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.seen import Columns, Seen
from jointid.models.controllers import FirstOrder, numbers_of, unit_of_number, with_numbers
from jointid.models.joints import ClosedLoop

_FACTOR = "torque, reference, ratio or a gain is wrong by a"
_DEGREES = 180 / math.pi
_GAINS = (1e-3, 1 / _DEGREES, 0.1, 0.3, 0.6, 1.6, 3.0, 10.0, _DEGREES, 1e3)  # times a declared gain, units among them
_INTEGRALS = (1e-3, 0.01, 0.1, 0.5, 2.0, 10.0, 100.0, 1e3)  # times a declared gain: its time may be in ms, read in s
_NEW_INTEGRALS = (1.0, 10.0, 100.0)  # 1/s, of what they act beside, where none is declared
_LATE = (1.0, 3.0, 8.0)  # periods of a delay or a filter
_HARDLY = 0.1  # periods: a filter or a delay that is off by less is none
_SMALL = math.log(1.5)  # a number that is off by less is left to its test, which gives an interval
_UNIT_SLIP = 1000.0  # s for ms
_NEAR = 0.1  # logarithm: a gain that is found so near to the factor of degrees is off by that
_ROUGHLY = 2.0  # times: a gain that is found so near to a unit's factor is off by that


# Words


def describe_number(finding: Finding, _: AxisFaults, spread: bool) -> str:
    """Return the clause on the difference of a number from its declaration, in percent of that.

    A sensitivity is no guide to a change as large as the number itself.
    """
    s = finding.test
    name, share, deviation = s.fault.phrase, s.size / abs(s.declared), 2 * s.std / abs(s.declared)
    if share <= -1:
        turned = "the torque has the wrong sign: set torque.sign = -1 in its channels"
        of_number = f"{_FACTOR} large factor ({name} alone would have to change its sign)"
        return turned if s.fault is LOG_GAIN else of_number
    if share > 1:
        return f"{_FACTOR} factor ({name} alone would be about {number(1 + share, 2)} times as large)"
    way = "smaller" if share < 0 else "larger"
    if deviation >= abs(share):
        return f"{name} is {way} than declared, by how much this record does not tell"
    at_most = share - deviation <= -1
    size = f"at least {number(100 * (abs(share) - deviation), 2)}" if at_most else number(100 * abs(share), 2)
    interval = f" ± {number(100 * deviation, 2)}" if spread and not at_most else ""
    return f"{name} is {size}{interval} % {way} than declared"


def _describe_delay(what: str, than: str, finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    unit, factor = ("ms", 1e3) if abs(s.size) >= MICROSECOND else ("us", 1e6)
    size = s.show_size(unit, spread=spread and check.of_loop, factor=factor)
    if size and not check.of_loop:  # one column says a long delay too small
        size = f"some {size}"
    clause = words(what, size, "later" if s.size > 0 else "earlier", f"than {than}")
    if s.fault is DELAY and s.size < 0 and s.declared <= 0.0:  # no torque comes before its command
        clause += ", as where the controller runs faster than the log: declare its period"
    return clause


# Gains


def _try_gain(name: str, declared: Hypothesis) -> Iterator[Hypothesis]:
    if value := declared.numbers.get(name):
        yield declared.starting_at(name, [factor * value for factor in _GAINS])


def _try_integral(declared: Hypothesis) -> Iterator[Hypothesis]:
    numbers = declared.numbers
    if numbers.get("integral_gain"):
        yield declared.starting_at("integral_gain", [factor * numbers["integral_gain"] for factor in _INTEGRALS])
        yield declared.under([replace(declared.controller, integral_gain=0.0)])
    elif "integral_gain" in numbers:
        unit = 1.0 if "velocity_gain" in numbers else numbers["position_gain"]
        yield declared.starting_at("integral_gain", [one * unit for one in _NEW_INTEGRALS])


def _say_gain(name: str, value: float | None, loop: ClosedLoop) -> str:
    """Return the clause on another gain than declared, and on a unit that may be mistaken."""
    if value is None:
        return f"the declared {name_number(name)} is not there"
    unit = unit_of_number(loop.controller, name, POSITION_UNIT[loop.joint.kind], loop.joint.force_unit)
    clause, declared = f"{call_number(name)} is about {number(value, 3)}", numbers_of(loop.controller).get(name)
    if not declared:
        return f"{clause} {unit}, and is not declared"
    clause, factor = f"{clause}, not {number(declared, 3)} {unit}", value / declared
    if abs(abs(math.log(factor)) - math.log(_DEGREES)) < _NEAR:
        times = "more" if factor > 1 else "less"
        return f"{clause}: about 57 times {times}; degrees and radians may be mistaken in its unit"
    if name != "integral_gain" or abs(math.log(max(factor, 1 / factor) / _UNIT_SLIP)) >= math.log(_ROUGHLY):
        return clause
    times, meant, read = ("more", "ms", "s") if factor > 1 else ("less", "s", "ms")
    return f"{clause}: about 1000 times {times}; the unit of the integral time may be {meant}, not {read}"


def is_small_factor(value: float | None, *_: object) -> bool:
    """Return True if a factor is so near to 1 that it is no cause."""
    return value is not None and value > 0 and abs(math.log(value)) < _SMALL


def _is_small_gain(name: str, value: float | None, loop: ClosedLoop, _: float) -> bool:
    declared = numbers_of(loop.controller).get(name, 0.0)
    return value is not None and declared > 0 and is_small_factor(value / declared)


def _gain(name: str, correct: Any = None) -> Fault:
    return Fault(
        name, name_number(name), call_number(name), describe_number, declared=None,
        correct=correct or partial(_try_gain, name), clause=partial(_say_gain, name),
        negligible=partial(_is_small_gain, name),
    )  # fmt: skip


def _swap_gains(declared: Hypothesis) -> Iterator[Hypothesis]:
    numbers, other = declared.numbers, _other_gain(declared.numbers)
    if numbers.get("position_gain") and numbers.get(other):
        gains = {"position_gain": numbers[other], other: numbers["position_gain"]}
        yield declared.under([with_numbers(declared.controller, gains)])


def _other_gain(numbers: Mapping[str, float]) -> str:
    return "velocity_gain" if "velocity_gain" in numbers else "derivative_gain"


SWAPPED_GAINS = Fault(
    "swapped_gains", "swapped gains", correct=_swap_gains,
    clause=lambda _, loop: f"position gain and {name_number(_other_gain(numbers_of(loop.controller)))} are swapped",
)  # fmt: skip


# Filters and delays


def _is_short(name: str, value: float | None, loop: ClosedLoop, period: float) -> bool:
    return value is not None and abs(value - numbers_of(loop.controller).get(name, 0.0)) < _HARDLY * period


def _filters(declared: Hypothesis) -> list[FirstOrder]:
    return [FirstOrder(late * declared.period) for late in _LATE]


def _try_velocity_filter(declared: Hypothesis) -> Iterator[Hypothesis]:
    law = declared.controller
    if hasattr(law, "velocity_filter"):
        others = [replace(law, velocity_filter=one) for one in _filters(declared)]
        yield declared.under(others, "velocity_filter.time_constant")
        yield declared.under([replace(law, velocity_filter=(1.0,))])


def _say_velocity_filter(value: float | None, _: ClosedLoop) -> str:
    if value is None:
        return "the declared velocity filter is not there"
    return f"the velocity filter is another one, such as one of first order with {milliseconds(value)} ms"


def _is_small_velocity_filter(value: float | None, loop: ClosedLoop, period: float) -> bool:
    declared = getattr(loop.controller, "velocity_filter", (1.0,))
    if isinstance(declared, tuple) and declared != (1.0,):
        return False  # a first order in the place of taps is no small change
    return _is_short("velocity_filter.time_constant", value, loop, period)


VELOCITY_FILTER = Fault(
    "velocity_filter", "velocity filter", "the velocity filter", correct=_try_velocity_filter,
    clause=_say_velocity_filter, negligible=_is_small_velocity_filter,
)  # fmt: skip


def _try_torque_filter(declared: Hypothesis) -> Iterator[Hypothesis]:
    law = declared.controller
    if hasattr(law, "torque_filters"):
        more = [replace(law, torque_filters=(one, *law.torque_filters)) for one in _filters(declared)]
        yield declared.under(more, "torque_filters.0.time_constant")


TORQUE_FILTER = Fault(
    "torque_filter", "torque filter", correct=_try_torque_filter,
    clause="there is one more torque filter, such as one of first order with {ms} ms",
    negligible=partial(_is_short, ""),  # one more than those that are declared
)  # fmt: skip


def _try_feedforward(declared: Hypothesis) -> Iterator[Hypothesis]:
    law, numbers = declared.controller, declared.numbers
    if "velocity_feedforward" in numbers:
        ahead = 0.0 if numbers["velocity_feedforward"] else 1.0
        yield declared.under([replace(law, velocity_feedforward=ahead)])
    elif hasattr(law, "reference_velocity"):
        read = "difference" if law.reference_velocity == "none" else "none"
        yield declared.under([replace(law, reference_velocity=read)])


def _say_feedforward(_: float | None, loop: ClosedLoop) -> str:
    law = loop.controller
    if hasattr(law, "velocity_feedforward"):
        return f"the velocity feed-forward is {'not there' if law.velocity_feedforward else 'not declared'}"
    reads = "reads" if getattr(law, "reference_velocity", "none") == "none" else "does not read"
    return f"the law {reads} the reference's velocity"


VELOCITY_FEEDFORWARD = Fault(
    "velocity_feedforward", "velocity feedforward", "the velocity feedforward", describe_number, declared=None,
    correct=_try_feedforward, clause=_say_feedforward,
)  # fmt: skip


def _try_delay(name: str, declared: Hypothesis) -> Iterator[Hypothesis]:
    if name in declared.numbers:
        yield declared.starting_at(name, [declared.numbers[name] + late * declared.period for late in _LATE])


def _say_delay(value: float | None, loop: ClosedLoop) -> str:
    declared = numbers_of(loop.controller).get("delay", 0.0)
    return f"the delay is about {milliseconds(value or 0.0)} ms, not {milliseconds(declared)} ms"


DELAY = Fault(
    "delay", "delay of the torque", "the delay", partial(_describe_delay, "the torque reacts", "declared"),
    declared=None, measure=Measure.TIME, correct=partial(_try_delay, "delay"), clause=_say_delay,
    negligible=partial(_is_short, "delay"),
)  # fmt: skip
REFERENCE_DELAY = Fault(
    "reference_delay", "reference delay", "the reference delay", describe_number, declared=None, measure=Measure.TIME,
    correct=partial(_try_delay, "reference_delay"), clause="the law sees the reference about {ms} ms late",
    negligible=partial(_is_short, "reference_delay"),
)  # fmt: skip


def _late(seen: Seen) -> Columns:
    if seen.loop is None:  # of a loop its derivative is exact
        yield None, -np.gradient(seen.torque, seen.sample_time)


LOG_DELAY = Fault(
    "log_delay", "delay of the log", "the log delay",
    partial(_describe_delay, "the logged torque is", "its time stamps say"), columns=_late, declared=None,
    measure=Measure.TIME,
)  # fmt: skip
LOG_GAIN = Fault("log_gain", "size of the logged torque", "the logged torque", describe_number, declared=None)
GAIN = Fault("gain", "gain of the controller's output", "the gain", describe_number, declared=None, last=True)

FAULTS = (
    _gain("position_gain"), _gain("derivative_gain"), SWAPPED_GAINS, _gain("integral_gain", _try_integral),
    VELOCITY_FILTER, TORQUE_FILTER, VELOCITY_FEEDFORWARD, DELAY, REFERENCE_DELAY, GAIN, LOG_GAIN, LOG_DELAY,
)  # fmt: skip
_BY_NAME = {one.name: one for one in FAULTS}


@cache
def number_fault(name: str) -> Fault:
    """Return the fault of a number of the controller or the log that is not as declared."""
    if name in _BY_NAME:
        return _BY_NAME[name]
    return Fault(name, name_number(name), call_number(name), describe_number, declared=None)
