"""Gross mistakes in declaration and log: table of corrections and their texts.

A torque that is g times too large, a reference that is g times too small and a law whose gain is g times too small give
the same record of another joint: ``u = g C(r - q)``. A number on the wrong side of a gear of ratio N is a factor of N
or N^2. So one change stands for all of them. The factor is a hint: 57.3 is an angle in degrees, 1000 a length in mm. To
add one, write its correction, its text and its row.

Laws that a drive may run instead of the declared one, with the same settings, are rows, too; `list_variants` yields
them. An integral may sum up the present error, and an averaged reference is late by half that time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

from jointid.common.arrays import FloatArray
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import number
from jointid.diagnostics.suspects import REFERENCE_DELAY, TORQUE_FILTER, Fault, OtherLaw, name_number
from jointid.models.controllers import PD, numbers_of, unit_of_number, with_numbers, with_present_sample
from jointid.models.controllers.filters import FirstOrder, Notch
from jointid.models.controllers.servo_base import Interpolation
from jointid.models.joints import ClosedLoop
from jointid.records.record import Channel, Record
from jointid.records.resampling import default_interpolation
from jointid.records.signals.filtering import Filtering

_DEGREES = 180 / math.pi
_GAINS = (1e-3, 1 / _DEGREES, 0.1, 0.3, 0.6, 1.6, 3.0, 10.0, _DEGREES, 1e3)  # times a declared gain, units among them
_INTEGRALS = (1e-3, 0.01, 0.1, 0.5, 2.0, 10.0, 100.0, 1e3)  # times a declared gain: its time may be in ms, read in s
_MINUTE = 60.0  # s: a gain is given in 1/s, or in 1/min
_NEW_INTEGRALS = (1.0, 10.0, 100.0)  # 1/s, of what they act beside, where none is declared
_LATE = (1.0, 3.0, 8.0)  # periods of a delay or a filter
_NOTCHES = (0.2, 0.4, 0.8, 1.6)  # of the band of the fit: centres of a notch
_TIMES = (0.1, 0.125, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 8.0, 10.0)  # times the sample time: rates that drives log at
_FACTORS = tuple(10 ** (k / 3) for k in range(-18, 19))  # of the loop's gain: also of the square of a gear's ratio
_SCALES = tuple(10 ** (k / 2) for k in range(-8, 9))  # of the torque, beside an injected signal
_UNITS = {"in degrees, not rad": _DEGREES, "in mm, not m": 1e3}  # of a reference, read without a factor
_NEAR = 0.08  # logarithm: a factor is taken for another one that is so near
_ROUGHLY = 0.3  # logarithm: unmodelled dynamics move a factor by so much; 75 is then 57.3, of an angle in degrees
_GEARED = 2 * math.sqrt(2) * math.exp(_ROUGHLY)  # times too small, roughly: more than peak-to-peak for rms, so a gear
_SMALL = math.log(1.5)  # a factor that is nearer to 1 is left to its test, which gives an interval
HARDLY = 0.1  # periods: a filter or a delay that is off by less is none
_NO_TIME = 1e-6  # s: no drive keeps so short a time
_TIME = "velocity_filter.time_constant"
NOTCH_DEPTH = "torque_filters.0.depth"
_IS_ABOUT = "{name} is about {shown}, not {declared}"


@dataclass(frozen=True, slots=True)
class Cause:
    """A mistake that explains the record of a joint or a robot.

    Attributes:
        name: its code.
        words: clause that states it, with its remedy.
        value: correct number in the unit of the declaration, or a factor of the record; None without a number.
        left: residual share of the filtered torque after its correction; of a robot the sum over joints of squared
            residuals relative to those as declared.
        joints: affected joints of a robot; empty for the base.
    """

    name: str
    words: str
    value: float | None = None
    left: float = 0.0
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A record and its loop, as declared or with one mistake corrected.

    Attributes:
        record: corrected.
        loop: corrected.
        filtering: resolved for this record.
        free: name of an unknown number outside the joint; "" without one.
        starts: start values of that number.
        factor: of the correction of the record, if it is a number; the free number multiplies it.
        beside: names of further free numbers outside the joint.
        change: that corrects the mistake; None as declared.
    """

    record: Record
    loop: ClosedLoop
    filtering: Filtering
    free: str = ""
    starts: tuple[float, ...] = ()
    factor: float | None = None
    beside: tuple[str, ...] = ()
    change: Change | None = None

    @property
    def controller(self) -> Any:
        """The controller of the loop."""
        return self.loop.controller

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers of that controller."""
        return numbers_of(self.controller)

    @property
    def torque(self) -> Channel:
        """The torque of the record."""
        assert self.record.torque is not None
        return self.record.torque

    @property
    def reference(self) -> Channel:
        """The reference of the record."""
        assert self.record.reference is not None
        return self.record.reference

    @property
    def period(self) -> float:
        """The controller's period, s: the torque's where none is declared."""
        return getattr(self.controller, "period", None) or self.torque.sample_time

    @property
    def loops(self) -> list[ClosedLoop]:
        """The loop at each start."""
        return [self.under(**{self.free: start}).loop for start in self.starts] or [self.loop]

    def under(self, controller: Any = None, **numbers: float) -> Case:
        """Return the case with another controller, or with other numbers of it."""
        law = with_numbers(controller or self.controller, numbers)
        return replace(self, loop=replace(self.loop, controller=law))

    def at(self, name: str, starts: Iterable[float]) -> Case:
        """The case with a number of the controller free, and its starts."""
        return replace(self, free=name, starts=tuple(starts))

    def logging(self, **channels: FloatArray) -> Case:
        """Return the case with other values of channels of its record."""
        return replace(self, record=self.record.with_channels(
            {name: replace(getattr(self.record, name), values=values) for name, values in channels.items()}
        ))  # fmt: skip


class Change(NamedTuple):
    """A row of the table: correction of a mistake, and its causes.

    Attributes:
        name: its code.
        correct: yields the cases in which it is corrected.
        say: yields the possible causes, from the identified number and the case as declared.
    """

    name: str
    correct: Callable[[Case], Iterable[Case]]
    say: Callable[[float | None, Case], Iterable[Cause]]


def is_small(cause: Cause, declared: Case, tested: bool = True) -> bool:
    """Test whether a cause is too near the declared value, or left to its test."""
    value, numbers = cause.value, declared.numbers
    if value is not None and cause.name.endswith(("scale", "gain")):
        known = numbers.get(cause.name, 1.0)
        return min(known, value) > 0 and abs(math.log(value / known)) < (_SMALL if tested else _NEAR)
    name = _TIME if cause.name == "velocity_filter" else cause.name
    unlike = name == _TIME and name not in numbers and declared.controller.velocity_filter != (1.0,)  # of another kind
    timed = value is not None and not unlike and cause.name.endswith(("delay", "filter"))
    return timed and abs((value or 0.0) - numbers.get(name, 0.0)) < HARDLY * declared.period


# What corrects them


def _try_number(name: str, times: Sequence[float], case: Case) -> Iterator[Case]:
    if value := case.numbers.get(name):
        yield case.at(name, (factor * value for factor in times))


def _try_integral(case: Case) -> Iterator[Case]:
    numbers = case.numbers
    yield from _try_number("integral_gain", _INTEGRALS, case)
    if numbers.get("integral_gain") == 0.0:
        unit = 1.0 if "velocity_gain" in numbers else numbers["position_gain"]
        yield case.at("integral_gain", (one * unit for one in _NEW_INTEGRALS))


def _try_delay(name: str, case: Case) -> Iterator[Case]:
    if name in case.numbers:
        yield case.at(name, (case.numbers[name] + late * case.period for late in _LATE))


def _swap_gains(case: Case) -> Iterator[Case]:
    numbers = case.numbers
    other = "velocity_gain" if "velocity_gain" in numbers else "derivative_gain"
    if numbers.get("position_gain") and numbers.get(other):
        yield case.under(**{"position_gain": numbers[other], other: numbers["position_gain"]})


def _try_filter(name: str, case: Case) -> Iterator[Case]:
    law, first, late = case.controller, FirstOrder(case.period), [one * case.period for one in _LATE]
    if name == "velocity_filter" and hasattr(law, name):
        yield case.under(replace(law, velocity_filter=first)).at(_TIME, late)
    elif name == "torque_filter" and hasattr(law, "torque_filters"):
        more = replace(law, torque_filters=(first, *law.torque_filters))
        yield case.under(more).at("torque_filters.0.time_constant", late)
    elif name == "notch" and hasattr(law, "torque_filters"):
        each = [share * (case.filtering.cutoff or 0.0) for share in _NOTCHES]
        more = replace(law, torque_filters=(Notch(each[0], each[0]), *law.torque_filters))
        free = (*case.beside, "torque_filters.0.bandwidth", NOTCH_DEPTH)
        yield replace(case, beside=free).under(more).at("torque_filters.0.frequency", each)


def _try_feedforward(case: Case) -> Iterator[Case]:
    law, numbers = case.controller, case.numbers
    if "velocity_feedforward" in numbers:
        yield case.under(velocity_feedforward=0.0 if numbers["velocity_feedforward"] else 1.0)
    elif hasattr(law, "reference_velocity"):
        read = "difference" if law.reference_velocity == "none" else "none"
        yield case.under(replace(law, reference_velocity=read))


def _try_limit(case: Case) -> Iterator[Case]:
    law = case.controller
    if case.numbers.get("limit") == math.inf:  # the largest torque may be it
        yield case.at("limit", (abs(case.torque.values / (law.gain * law.ratio)).max(),))


def _try_sample_times(case: Case) -> Iterator[Case]:
    assert case.filtering.cutoff is not None and case.filtering.position_cutoff is not None
    own = getattr(case.controller, "period", None)  # of which a whole number passes from sample to sample
    for factor in _TIMES:
        if own is not None and abs(math.remainder(factor * case.torque.sample_time, own)) > _NO_TIME:
            continue
        channels = {n: replace(c, sample_time=factor * c.sample_time) for n, c in case.record.items()}
        cutoffs = {name: getattr(case.filtering, name) / factor for name in ("cutoff", "position_cutoff")}
        record, filtering = case.record.with_channels(channels), replace(case.filtering, **cutoffs)
        yield replace(case, record=record, filtering=filtering, factor=factor)


def _try_torque_scales(case: Case) -> Iterator[Case]:
    """Yield other torque scales beside an injected signal, which keeps its own."""
    for factor in _SCALES if case.record.injected is not None else ():
        yield replace(case.logging(torque=case.torque.values / factor), free="log_gain", factor=factor)


def _try_factors(case: Case) -> Iterator[Case]:
    numbers = case.numbers
    if "gain" in numbers:
        # A limit that was declared beside a wrong scale is wrong, too, or not: without one both are tried.
        endless = {"limit": math.inf} if "limit" in numbers else {}
        yield case.under(**endless).at("gain", (factor * numbers["gain"] for factor in _FACTORS))


# What they then are


def _is(factor: float, other: float, near: float = _NEAR) -> bool:
    """Whether a factor, or its inverse, is another one."""
    return min(abs(math.log(factor / other)), abs(math.log(factor * other))) < near


def _say_times(factor: float) -> str:
    """Return a factor above 1, or its inverse, in words."""
    return f"about {number(max(factor, 1 / factor), 2)} times"


def _say_factor(of_torque: bool, value: float | None, case: Case) -> Iterator[Cause]:
    """Yield causes of a torque or law factor, the most specific first."""
    assert value is not None
    numbers, constant = case.numbers, getattr(case.controller, "gain", 1.0)
    factor, gear = value if of_torque else value / numbers["gain"], case.loop.joint.transmission
    ratio = abs(getattr(case.controller, "ratio", 1.0) if gear is None else gear.motor_per_load)
    if ratio != 1.0 and (_is(factor, ratio) or _is(factor, ratio**2)):
        actual = "load" if (factor > 1) is (ratio > 1) else "motor"
        side = f"torque, reference or law is on the wrong side of the {ratio:g}:1 gear"
        yield Cause("gear_side", f'{side} (give the channel side = "{actual}", or see side of [controller])', factor)
    times = _say_times(factor)
    size, other = ("large", "small") if factor > 1 else ("small", "large")
    unit = next((unit for unit, by in _UNITS.items() if factor < 1 and _is(factor, by, _ROUGHLY)), "")
    names = " or ".join(name for name in ("velocity_gain", "gain") if name in numbers)
    torque = [Cause("torque_scale", f"the torque is {times} too {size}", factor)]
    if constant != 1.0 and _is(factor, constant):
        said = f"the torque constant ({constant:g}) is applied twice, or not at all"
        torque.insert(0, Cause("torque_constant", said, factor))
    lead = getattr(gear, "lead", None)
    geared = f"a lead of {number(1e3 * lead / factor, 2)} mm" if lead else f"a gear of {number(ratio * factor, 2)}:1"
    geared = f", as by {geared}" if gear is not None or ratio * factor > 1 else ""  # none has less than 1:1
    reference = [Cause("reference_scale", f"the reference is {unit or f'{times} too {other}{geared}'}", 1 / factor)]
    law = [Cause("law_gain", f"the law's gain ({names}) is declared {times} too {other}", factor)]
    for causes in (reference, torque, law) if unit or (gear is None and factor > _GEARED) else (law, torque, reference):
        if case.record.injected is None or (causes is torque) is of_torque:
            yield from causes


def _say_number(name: str, clause: str, value: float | None, case: Case) -> Iterator[Cause]:
    """Yield one mistake; its clause may contain {name}, {shown}, {declared} and {or_log}."""

    def show(value: float) -> str:
        if name.endswith(("delay", "filter")):
            return f"{number(1e3 * value, 2) if abs(value) >= _NO_TIME else 0} ms"
        joint = case.loop.joint
        unit = unit_of_number(case.controller, name, POSITION_UNIT[joint.kind], joint.force_unit)
        time = f" (Tn {number(1e3 / value, 3)} ms)" if name == "integral_gain" and unit == "1/s" and value else ""
        return f"{number(value, 3) if value else 0} {unit}".rstrip() + time

    declared = case.numbers.get(name, 0.0)
    if name == "position_gain" and value and declared / value > 1.0 and _is(declared / value, _MINUTE):
        clause += ": it is given in 1/min, as its value shows"
    words = {"name": f"the {name_number(name)}", "or_log": ", or the log," if case.record.injected is None else ""}
    numbers = {"shown": show(value or 0.0), "declared": show(declared)} if "{" in clause else {}
    yield Cause(name, clause.format(**words, **numbers), value)


def _row(name: str, correct: Callable[[Case], Iterable[Case]], clause: str = _IS_ABOUT) -> Change:
    return Change(name, correct, partial(_say_number, name, clause))


_SIGNS = [
    Cause(f"{name}_sign", f"the {name} has the wrong sign (reverse record.channels.{name}.sign)")
    for name in ("torque", "reference")
]
CHANGES = (
    Change("torque_sign", lambda case: [case.logging(torque=-case.torque.values)], lambda *_: _SIGNS),
    _row(
        "swapped_channels", lambda case: [case.logging(torque=case.reference.values, reference=case.torque.values)]
        if len(case.torque) == len(case.reference) else [], "torque and reference are swapped",
    ),
    Change("sample_time", _try_sample_times, lambda value, _: [
        Cause("sample_time", f"the sample time is {_say_times(value)} too {'short' if value > 1 else 'long'}", value)
    ] if value else []),
    Change("torque_scale", _try_torque_scales, partial(_say_factor, True)),
    Change("law_gain", _try_factors, partial(_say_factor, False)),
    _row("position_gain", partial(_try_number, "position_gain", _GAINS)),
    _row("derivative_gain", partial(_try_number, "derivative_gain", _GAINS)),
    _row("swapped_gains", _swap_gains, "position gain and velocity (or derivative) gain are swapped"),
    _row("integral_gain", _try_integral),
    _row(
        "velocity_filter", partial(_try_filter, "velocity_filter"),
        "the velocity filter is another one, such as one of first order with {shown}",
    ),
    _row(
        "torque_filter", partial(_try_filter, "torque_filter"),
        "there is one more torque filter, such as one of first order with {shown}: declare it in torque_filters",
    ),
    _row("notch", partial(_try_filter, "notch"), "the torque passes a notch near {shown} Hz: see torque_filters"),
    _row(
        "velocity_feedforward", _try_feedforward,
        "the velocity feed-forward acts and is not declared, or the reverse",
    ),
    _row("limit", _try_limit, "the controller's output is limited to {shown}, which is not declared"),
    _row("delay", partial(_try_delay, "delay")),
    _row("reference_delay", partial(_try_delay, "reference_delay"), "the reference{or_log} is {shown} late"),
)  # fmt: skip


# What a drive may run instead

_TIMES_FASTER = (2, 4, 8)  # than the log: at these rates a drive may run whose period is not declared
_SLOWER = 1.5  # times the controller's period: a reference of such a sample time is filled in
SCREENED = 4  # samples of the log: of a mean that shows whether the reference is late
_HALF_A_PERIOD_EARLIER = (1.5, -0.5)  # of a difference of positions, which is the velocity half a period ago

_DONE: dict[Interpolation, str] = {"hold": "held", "linear": "interpolated by lines", "cubic": "interpolated by cubics"}
PRESENT_SAMPLE = Fault("present_sample", "integral that takes in the present sample")
MEASURED_VELOCITY = Fault("measured_velocity", "velocity that is no difference of positions")
PERIOD = Fault("period", "period of the controller")
INTERPOLATIONS: dict[Interpolation, Fault] = {
    way: Fault(
        "held_reference" if way == "hold" else f"{way}_reference", f"reference {done} between its samples",
        remedy=f'declare interpolation = "{way}"',
    )
    for way, done in _DONE.items()
}  # fmt: skip
AVERAGED = Fault(
    "averaged_reference", "reference averaged by the drive",
    remedy="declare it as reference_average, or half of it as reference_delay",
)  # fmt: skip
WHOLE = tuple(one.name for one in INTERPOLATIONS.values())  # that a drive has or has not, so that their size is 1
DEAD_TIME = Fault("dead_time", "delay of the torque and of its log")
OF_REFERENCE = (REFERENCE_DELAY, AVERAGED, TORQUE_FILTER, DEAD_TIME, *INTERPOLATIONS.values())
"""Those that differ in what they make of the reference, and a torque that is as late."""
_TIMED = {
    AVERAGED: ("reference_average", "the drive averages the reference over {} ms"),
    REFERENCE_DELAY: ("reference_delay", "the law sees the reference {} ms late"),
    TORQUE_FILTER: ("torque_filters", "the torque passes a notch, or a filter such as one of first order with {} ms"),
    DEAD_TIME: ("delay", "the torque is late, as by a dead time of the drive, by {} ms"),
}  # fmt: skip
OPEN = (PRESENT_SAMPLE, PERIOD, *INTERPOLATIONS.values())  # those that are said where a record does not exclude them
OTHER_LAWS = tuple(one.name for one in (PRESENT_SAMPLE, MEASURED_VELOCITY, PERIOD, *OF_REFERENCE))


def list_changes(case: Case) -> Iterator[Change]:
    """Yield all changes in order: the table, then other laws of drives."""
    yield from CHANGES
    for laws in list_variants(case.controller, case.record, case.torque.sample_time, case.period):
        for law in (one for one in laws if one.fault is PERIOD or one.fault.name in WHOLE):
            period = law.controller.period if law.fault is PERIOD else None
            said = Cause(law.fault.name, f"{law.words}: declare {law.remedy}", period)
            correct = partial(lambda law, case: [case.under(law.controller)], law)
            yield Change(said.name, correct, lambda *_, said=said: [said])


def list_variants(law: Any, record: Record, log: float, period: float) -> Iterator[tuple[OtherLaw, ...]]:
    """Yield other uses of reference, position and velocity, as laws, simplest first.

    The effect of the first law shows whether the record can distinguish it. Cubics matter to a law that
    differentiates the reference: lines delay the velocity by half a sample.

    `log` is the sample time of the torque, and `period` that of the law, s.
    """
    assert record.reference is not None
    for way in _list_other_ways(law, record, period):
        said, filled = f"the reference is {_DONE[way]} between its samples", replace(law, interpolation=way)
        yield (OtherLaw(INTERPOLATIONS[way], said, f'interpolation = "{way}"', filled),)
    if getattr(law, "reference_average", None) == 0.0:
        lags = () if getattr(law, "torque_filters", True) else (change_time(law, TORQUE_FILTER, log / SCREENED),)
        yield (change_time(law, AVERAGED, SCREENED * log), *lags)
    yield from ((one,) for one in list_feedback_laws(law, period))
    if getattr(law, "period", period) is not None:
        return
    used, least = law.interpolation or default_interpolation(record.reference), log / _TIMES_FASTER[0]
    differentiates = isinstance(law, PD) and law.reference_velocity == "difference"
    differentiates |= any(getattr(law, f"{one}_feedforward", 0.0) for one in ("velocity", "viscous", "acceleration"))
    for other in (None, *_list_other_ways(replace(law, period=least), record, least)):
        if other == "cubic" and not differentiates:
            continue
        faster: Any = law if other is None else replace(law, interpolation=other)
        more = "" if other is None else f", with its reference {_DONE[other]}"
        yield tuple(
            OtherLaw(
                PERIOD, f"the controller runs faster than the log, at {1e-3 * times / log:.4g} kHz{more}",
                f'its period, {1e3 * log / times:.4g} ms, and interpolation = "{other or used}"',
                replace(faster, period=log / times),
            )
            for times in _TIMES_FASTER
        )  # fmt: skip


def change_time(law: Any, fault: Fault, time: float) -> OtherLaw:
    """Return a law with another time of its reference or its torque, s."""
    key, said = _TIMED[fault]
    begin, end = ('[{ kind = "first_order", time_constant = ', " }]") if fault is TORQUE_FILTER else ("", "")
    changed = replace(law, **{key: (FirstOrder(time),) if fault is TORQUE_FILTER else time})
    return OtherLaw(fault, said.format(number(1e3 * time, 3)), f'{key} = {begin}"{1e3 * time:.4g} ms"{end}', changed)


def list_feedback_laws(controller: Any, period: float) -> Iterator[OtherLaw]:
    """Yield other laws with the same settings at the same rate."""
    if getattr(controller, "integral_gain", 0.0):
        other, gain, more = with_present_sample(controller, period), "position_gain", ""
        if hasattr(controller, "velocity_gain"):
            gain, more = "velocity_gain", f" and the integral time {number(1e3 * period, 3)} ms longer"
        share = number(100 * (getattr(other, gain) / getattr(controller, gain) - 1), 2)
        words = "the integral takes in the present sample, too"
        yield OtherLaw(PRESENT_SAMPLE, words, f"{gain} {share} % larger{more}", other)
    if getattr(controller, "velocity_filter", None) == (1.0,):
        words = "the velocity is measured or observed, half a period earlier than a difference of positions"
        earlier = replace(controller, velocity_filter=_HALF_A_PERIOD_EARLIER)
        yield OtherLaw(MEASURED_VELOCITY, words, f"velocity_filter = {list(_HALF_A_PERIOD_EARLIER)}", earlier)


def _list_other_ways(controller: Any, record: Record, period: float) -> tuple[Interpolation, ...]:
    """Interpolations other than the one in use; none if one is declared."""
    assert record.reference is not None
    declared = getattr(controller, "interpolation", "none is possible")
    if declared is not None or record.reference.sample_time < _SLOWER * period:
        return ()
    return tuple(way for way in _DONE if way != default_interpolation(record.reference))
