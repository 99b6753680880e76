"""Factors on the gain of the whole loop, whose causes no record distinguishes.

A torque that is g times too large, a reference that is g times too small and a law whose gain is g times too small give
the same record of another joint: ``u = g C(r - q)``. A number on the wrong side of a gear of ratio N is a factor of N
or N^2. So one hypothesis stands for all of them. The factor is a hint: 57.3 is an angle in degrees, 1000 a length in
mm, a gear's ratio or its square the wrong side of the gear.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from jointid.common.text import number
from jointid.diagnostics.faults.fault import Fault, Hypothesis, Meaning
from jointid.diagnostics.faults.numbers import is_small_factor
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop

_DECADES = 4  # of the factor on the loop's gain, up and down
_FACTORS = tuple(10 ** (k / 3) for k in range(-3 * _DECADES, 3 * _DECADES + 1))
_SCALES = tuple(10 ** (k / 2) for k in range(-6, 7))  # of the torque, beside an injected signal
_NEAR = 0.08  # logarithm: a factor is taken for another one that is so near
_ROUGHLY = 0.3  # logarithm: unmodelled dynamics move a factor by so much; 75 is then 57.3, of an angle in degrees
_UNITS = {"in degrees, not rad": 180 / math.pi, "in mm, not m": 1e3}  # of a reference, read without a factor


def _gear_ratio(loop: ClosedLoop) -> float:
    """Return the ratio of a loop's gear, motor per load, without its sign; 1 without a gear."""
    gear = loop.joint.transmission
    return abs(gear.motor_per_load) if gear is not None else abs(getattr(loop.controller, "ratio", 1.0))


def _known_factors(loop: ClosedLoop) -> tuple[float, ...]:
    """Return the factors of known mistakes: a unit, a gear's ratio, a torque constant that is applied twice."""
    ratio, constant = _gear_ratio(loop), abs(getattr(loop.controller, "gain", 1.0))
    known = (*(1 / one for one in _UNITS.values()), ratio, ratio**2, 1 / ratio, 1 / ratio**2, constant, 1 / constant)
    return tuple(sorted({one for one in known if one != 1.0}))


def _try_torque_scales(declared: Hypothesis) -> Iterator[Hypothesis]:
    """Yield the torque in other scales beside an injected signal, which keeps its own."""
    torque = declared.record.torque
    if declared.record.injected is None or torque is None:
        return
    for factor in (*_SCALES, *_known_factors(declared.loops[0])):
        scaled = {"torque": replace(torque, values=torque.values / factor)}
        yield replace(declared, record=declared.record.with_channels(scaled), free="log_gain", factor=factor)


def _try_factors(declared: Hypothesis) -> Iterator[Hypothesis]:
    numbers, law = declared.numbers, declared.controller
    if "gain" not in numbers:
        return
    # A limit that was declared beside a wrong scale is wrong, too, or not: without one both are tried.
    endless = with_numbers(law, {"limit": float("inf")}) if "limit" in numbers else law
    excess = [one for one in _known_factors(declared.loops[0]) if not _FACTORS[0] <= one <= _FACTORS[-1]]
    scaled = [with_numbers(endless, {"gain": factor * numbers["gain"]}) for factor in (*_FACTORS, *excess)]
    factors = declared.under(scaled, "gain")
    yield factors if declared.record.injected is None else replace(factors, fault=_LAW_BESIDE_INJECTED)


def _explain_beside_injected(of_torque: bool, value: float | None, loop: ClosedLoop) -> Iterator[Meaning]:
    """Yield the meanings that a signal in its own scale leaves: those of the torque, or of law and reference."""
    law = (LAW_GAIN, REFERENCE_SCALE)
    if of_torque and value is not None:  # it is found as a factor, those of the law as its gain
        value *= numbers_of(loop.controller)["gain"]
    for fault, clause, factor in _explain_factor(value, loop):
        if fault not in (law if of_torque else (TORQUE_SCALE, TORQUE_CONSTANT)):
            yield fault, clause, factor


def _explain_factor(value: float | None, loop: ClosedLoop) -> Iterator[Meaning]:
    assert value is not None
    numbers, ratio = numbers_of(loop.controller), _gear_ratio(loop)
    factor = value / numbers["gain"]
    times = say_times(factor)
    size, other = ("large", "small") if factor > 1 else ("small", "large")
    if ratio != 1.0 and (_is(factor, ratio) or _is(factor, ratio**2)):
        actual = "load" if (factor > 1) is (ratio > 1) else "motor"
        side = f"torque, reference or law is on the wrong side of the {ratio:g}:1 gear"
        yield GEAR_SIDE, f'{side} (give the channel side = "{actual}", or see side of [controller])', factor
    constant = getattr(loop.controller, "gain", 1.0)
    if constant != 1.0 and _is(factor, constant):
        yield TORQUE_CONSTANT, f"the torque constant ({constant:g}) is applied twice, or not at all", factor
    torque = (TORQUE_SCALE, f"the torque is {times} too {size}", factor)
    unit = next((unit for unit, by in _UNITS.items() if factor < 1 and _is(factor, by, _ROUGHLY)), "")
    reference = (REFERENCE_SCALE, f"the reference is {unit or f'{times} too {other}'}", 1 / factor)
    names = " or ".join(name for name in ("velocity_gain", "gain") if name in numbers)
    law = (LAW_GAIN, f"the law's gain ({names}) is declared {times} too {other}", factor)
    yield from (reference, torque, law) if unit else (torque, law, reference)


def _is(factor: float, other: float, near: float = _NEAR) -> bool:
    """Whether a factor, or its inverse, is another one."""
    return min(abs(math.log(factor / other)), abs(math.log(factor * other))) < near


def say_times(factor: float) -> str:
    """Return a factor above 1, or its inverse, in words."""
    return f"about {number(max(factor, 1 / factor), 2)} times"


GEAR_SIDE = Fault("gear_side", "side of the gear")
TORQUE_CONSTANT = Fault("torque_constant", "torque constant")
TORQUE_SCALE = Fault(
    "torque_scale", "scale of the torque", correct=_try_torque_scales, meanings=partial(_explain_beside_injected, True),
    negligible=is_small_factor,
)  # fmt: skip
REFERENCE_SCALE = Fault("reference_scale", "scale of the reference", negligible=is_small_factor)
LAW_GAIN = Fault(
    "law_gain", "gain of the law", correct=_try_factors, meanings=_explain_factor, negligible=is_small_factor,
)  # fmt: skip
_LAW_BESIDE_INJECTED = replace(LAW_GAIN, meanings=partial(_explain_beside_injected, False))

FAULTS = (GEAR_SIDE, TORQUE_CONSTANT, TORQUE_SCALE, REFERENCE_SCALE, LAW_GAIN)
