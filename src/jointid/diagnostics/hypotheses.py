"""Causes of a record that does not fit the declared drive, each put right: the record or the loop is corrected.

A cause is either one thing, as channels that were swapped, or a number of the controller that is not known; then there
are several loops to begin from, and that number is free.

Not all causes can be told apart. A torque that is g times too large, a reference that is g times too small and a law
whose gain is g times too small make the same record of another joint: ``u = g C(r - q)``, whichever way g came in. A
number on the wrong side of a gear of ratio N is such a factor of N or N^2. So there is one hypothesis for all of them.
Likewise a torque and a reference that are turned round differ only in the sign of the joint's position.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from jointid.models.controllers import FirstOrder, numbers_of, with_numbers
from jointid.models.controllers.servo_base import DiagramController
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering


class Cause(StrEnum):
    """Causes of a record that does not fit, as codes."""

    TORQUE_SCALE = "torque_scale"
    TORQUE_CONSTANT = "torque_constant"
    TORQUE_SIGN = "torque_sign"
    REFERENCE_SCALE = "reference_scale"
    REFERENCE_SIGN = "reference_sign"
    GEAR_SIDE = "gear_side"
    LAW_GAIN = "law_gain"
    SWAPPED_CHANNELS = "swapped_channels"
    REFERENCE_IS_POSITION = "reference_is_position"
    SWAPPED_GAINS = "swapped_gains"
    POSITION_GAIN = "position_gain"
    DERIVATIVE_GAIN = "derivative_gain"
    INTEGRAL = "integral"
    VELOCITY_FILTER = "velocity_filter"
    TORQUE_FILTER = "torque_filter"
    SAMPLE_TIME = "sample_time"
    PERIOD = "period"
    VELOCITY_FEEDFORWARD = "velocity_feedforward"
    DELAY = "delay"
    REFERENCE_DELAY = "reference_delay"
    INJECTED = "injected"
    FLEXIBLE = "flexible"


_DECADES = 4  # of the factor on the loop's gain, up and down
_FACTORS = tuple(10 ** (k / 3) for k in range(-3 * _DECADES, 3 * _DECADES + 1))
_GAINS = (0.1, 0.3, 0.6, 1.6, 3.0, 10.0)  # times a declared gain
_INTEGRALS = (1e-3, 0.01, 0.1, 10.0, 100.0, 1e3)  # times a declared integral gain: its time may be in ms, read in s
_NEW_INTEGRALS = (1.0, 10.0, 100.0)  # 1/s, of what they act beside, where none is declared
_TIMES = (0.1, 0.125, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 8.0, 10.0)  # times the sample time: rates that drives log at
_FASTER = (2, 4, 8)  # times the log's rate: further ones leave as much
_LATE = (1.0, 3.0, 8.0)  # periods of a delay or a filter
UNITS = {"in degrees, not rad": 180 / math.pi, "in mm, not m": 1e3}
"""Units in which a reference is read without a factor, and how many of them make one of what is declared."""


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One cause put right.

    Attributes:
        cause: that it is; None for the drive as it is declared.
        record: corrected.
        loops: corrected, one for each start of the number that is not known.
        filtering: resolved for this record.
        free: name of that number; None where there is none.
        factor: by which the record was corrected, where that is a number.
    """

    cause: Cause | None
    record: Record
    loops: tuple[ClosedLoop, ...]
    filtering: Filtering
    free: str | None = None
    factor: float | None = None


def list_hypotheses(record: Record, loop: ClosedLoop, filtering: Filtering) -> tuple[Hypothesis, ...]:
    """Return the drive as it is declared, and every cause that this record and controller can have put right.

    Args:
        record: with torque and reference.
        loop: as it is declared.
        filtering: resolved.
    """
    declared = Hypothesis(None, record, (loop,), filtering)
    return (declared, *_of_record(declared), *_of_loop(declared))


def _of_record(declared: Hypothesis) -> Iterator[Hypothesis]:
    """Yield the causes that are in the record."""
    record, filtering = declared.record, declared.filtering
    torque, reference = record.torque, record.reference
    assert torque is not None
    assert reference is not None
    turned = record.with_channels({"torque": replace(torque, values=-torque.values)})
    yield replace(declared, cause=Cause.TORQUE_SIGN, record=turned)
    if len(torque) == len(reference):
        channels = {
            "torque": replace(torque, values=reference.values),
            "reference": replace(reference, values=torque.values),
        }
        yield replace(declared, cause=Cause.SWAPPED_CHANNELS, record=record.with_channels(channels))
    if getattr(declared.loops[0].controller, "period", None) is not None:
        return  # a controller with a period of its own contradicts a wrong sample time before anything is simulated
    for factor in _TIMES:
        channels = {n: replace(c, sample_time=factor * c.sample_time) for n, c in record.items()}
        yield replace(
            declared,
            cause=Cause.SAMPLE_TIME,
            record=record.with_channels(channels),
            filtering=with_cutoffs(filtering, 1 / factor),
            factor=factor,
        )


def gear_ratio(loop: ClosedLoop) -> float:
    """Return the ratio of a loop's gear, motor per load, without its sign; 1 without a gear."""
    gear = loop.joint.transmission
    return abs(gear.motor_per_load) if gear is not None else abs(getattr(loop.controller, "ratio", 1.0))


def known_factors(loop: ClosedLoop) -> tuple[float, ...]:
    """Return factors on the loop's gain that a known mistake makes: a unit, a gear's ratio, a torque constant twice."""
    ratio, constant = gear_ratio(loop), abs(getattr(loop.controller, "gain", 1.0))
    known = (*(1 / one for one in UNITS.values()), ratio, ratio**2, 1 / ratio, 1 / ratio**2, constant, 1 / constant)
    return tuple(sorted({one for one in known if one != 1.0}))


def with_cutoffs(filtering: Filtering, factor: float) -> Filtering:
    """Return a resolved filtering with its cut-offs so many times as high."""
    assert filtering.cutoff is not None
    assert filtering.position_cutoff is not None
    return replace(filtering, cutoff=factor * filtering.cutoff, position_cutoff=factor * filtering.position_cutoff)


def _of_loop(declared: Hypothesis) -> Iterator[Hypothesis]:
    """Yield the causes that are in the controller's declaration."""
    loop = declared.loops[0]
    controller: Any = loop.controller
    numbers = numbers_of(controller)
    assert declared.record.torque is not None
    period = getattr(controller, "period", None) or declared.record.torque.sample_time

    def told(cause: Cause, controllers: Sequence[Any], free: str | None = None) -> Hypothesis:
        loops = tuple(replace(loop, controller=one) for one in controllers)
        return replace(declared, cause=cause, loops=loops, free=free)

    def numbered(cause: Cause, name: str, values: Sequence[float]) -> Hypothesis:
        return told(cause, [with_numbers(controller, {name: value}) for value in values], name)

    if "gain" in numbers:
        # A limit that was declared beside a wrong scale is wrong, too, or not: without one both are tried.
        endless = with_numbers(controller, {"limit": float("inf")}) if "limit" in numbers else controller
        beyond = [one for one in known_factors(loop) if not _FACTORS[0] <= one <= _FACTORS[-1]]
        scaled = [with_numbers(endless, {"gain": factor * numbers["gain"]}) for factor in (*_FACTORS, *beyond)]
        yield told(Cause.LAW_GAIN, scaled, "gain")
    for name, cause in (("position_gain", Cause.POSITION_GAIN), ("derivative_gain", Cause.DERIVATIVE_GAIN)):
        if numbers.get(name):
            yield numbered(cause, name, [factor * numbers[name] for factor in _GAINS])
    other = "velocity_gain" if "velocity_gain" in numbers else "derivative_gain"
    if numbers.get("position_gain") and numbers.get(other):
        gains = {"position_gain": numbers[other], other: numbers["position_gain"]}
        yield told(Cause.SWAPPED_GAINS, [with_numbers(controller, gains)])
    if numbers.get("integral_gain"):
        yield numbered(Cause.INTEGRAL, "integral_gain", [factor * numbers["integral_gain"] for factor in _INTEGRALS])
        yield told(Cause.INTEGRAL, [replace(controller, integral_gain=0.0)])
    elif "integral_gain" in numbers:
        unit = 1.0 if "velocity_gain" in numbers else numbers["position_gain"]
        yield numbered(Cause.INTEGRAL, "integral_gain", [one * unit for one in _NEW_INTEGRALS])
    yield from _of_filters(controller, period, told)
    if isinstance(controller, DiagramController) and controller.period is None:
        yield told(Cause.PERIOD, [replace(controller, period=period / times) for times in _FASTER])
    if "velocity_feedforward" in numbers:
        ahead = 0.0 if numbers["velocity_feedforward"] else 1.0
        yield told(Cause.VELOCITY_FEEDFORWARD, [replace(controller, velocity_feedforward=ahead)])
    elif hasattr(controller, "reference_velocity"):
        read = "difference" if controller.reference_velocity == "none" else "none"
        yield told(Cause.VELOCITY_FEEDFORWARD, [replace(controller, reference_velocity=read)])
    if "delay" in numbers:
        yield numbered(Cause.DELAY, "delay", [numbers["delay"] + late * period for late in _LATE])
    if "reference_delay" in numbers:
        late = [numbers["reference_delay"] + late * period for late in _LATE]
        yield numbered(Cause.REFERENCE_DELAY, "reference_delay", late)


def _of_filters(controller: Any, period: float, told: Callable[..., Hypothesis]) -> Iterator[Hypothesis]:
    """Yield another velocity filter, none, and one more filter of the torque."""
    filters = [FirstOrder(late * period) for late in _LATE]
    if hasattr(controller, "velocity_filter"):
        others = [replace(controller, velocity_filter=one) for one in filters]
        yield told(Cause.VELOCITY_FILTER, others, "velocity_filter.time_constant")
        yield told(Cause.VELOCITY_FILTER, [replace(controller, velocity_filter=(1.0,))])
    if hasattr(controller, "torque_filters"):
        more = [replace(controller, torque_filters=(one, *controller.torque_filters)) for one in filters]
        yield told(Cause.TORQUE_FILTER, more, "torque_filters.0.time_constant")
