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
from jointid.diagnostics.faults.fault import Fault, Hypothesis, Meaning, Shown, call_number
from jointid.diagnostics.faults.numbers import is_small_factor, show
from jointid.diagnostics.hypothesis_fits import FIRST, Fit, descend
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop

_DECADES = 4  # of the factor on the loop's gain, up and down
_FACTORS = tuple(10 ** (k / 3) for k in range(-3 * _DECADES, 3 * _DECADES + 1))
_SCALES = tuple(10 ** (k / 2) for k in range(-6, 7))  # of the torque, beside an injected signal
_NEAR = 0.08  # logarithm: a factor is taken for another one that is so near
_RENAMED = 1.5  # times: a factor that is found so near to a known one may be that one
_HARDLY_MORE = 1.03  # times the error that a factor leaves: a known one that leaves no more is as good
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


def _prefer_known_factor(fit: Fit, loop: ClosedLoop) -> Fit:
    """Return the fit with a known factor, if its residual is hardly larger.

    Unmodelled dynamics shift a free factor; 75 is then 57.3, the factor of an angle in degrees.
    """
    if fit.number is None:
        return fit
    declared = numbers_of(loop.controller)["gain"]
    near = sorted((abs(math.log(factor * declared / fit.number)), factor) for factor in _known_factors(loop))
    for far, factor in near:
        if far > math.log(_RENAMED):
            break
        held = fit.problem.keeping({"gain": factor * declared})
        end = descend(replace(fit, problem=held, x=held.vector(fit.values)), FIRST)
        if end is not None and end.error <= _HARDLY_MORE * fit.error:
            return end
    return fit


def _explain_beside_injected(of_torque: bool, value: float | None, loop: ClosedLoop, shown: Shown) -> Iterator[Meaning]:
    """Yield the meanings that a signal in its own scale leaves: those of the torque, or of law and reference."""
    law = (LAW_GAIN, REFERENCE_SCALE)
    if of_torque and value is not None:  # it is found as a factor, those of the law as its gain
        value *= numbers_of(loop.controller)["gain"]
    for fault, clause, factor in _explain_factor(value, loop, shown):
        if fault not in (law if of_torque else (TORQUE_SCALE, TORQUE_CONSTANT)):
            yield fault, clause, factor


def _explain_factor(value: float | None, loop: ClosedLoop, shown: Shown) -> Iterator[Meaning]:
    assert value is not None
    numbers, ratio = numbers_of(loop.controller), _gear_ratio(loop)
    factor = value / numbers["gain"]
    times, by_gear = say_times(factor), ""
    size, other = ("large", "small") if factor > 1 else ("small", "large")
    if ratio != 1.0 and _is(factor, ratio):
        actual, read = ("load", "motor") if (factor > 1) is (ratio > 1) else ("motor", "load")
        side = f"the reference, or the torque, is on the wrong side of the {ratio:g}:1 gear: it is the {actual}'s and"
        yield GEAR_SIDE, f'{side} read as the {read}\'s (give its channel side = "{actual}")', factor
    elif ratio != 1.0 and _is(factor, ratio**2):
        side = f"the controller is on the wrong side of the {ratio:g}:1 gear (side of [controller])"
        yield GEAR_SIDE, f"{side}, or torque and reference are both", factor
    elif ratio != 1.0:
        by_gear = f", as by another gear than {ratio:g}:1"
    constant = getattr(loop.controller, "gain", 1.0)
    if constant != 1.0 and _is(factor, constant):
        yield TORQUE_CONSTANT, f"the torque constant ({constant:g}) is applied twice, or not at all", factor
        by_gear = ""
    torque = (TORQUE_SCALE, f"the torque is {times} too {size}", factor)
    unit = next((unit for unit, by in _UNITS.items() if factor < 1 and _is(factor, by)), "")
    reference = (REFERENCE_SCALE, f"the reference is {unit or f'{times} too {other}{by_gear}'}", 1 / factor)
    leading, would = "velocity_gain", ""
    names = " or ".join(name for name in (leading, "gain") if name in numbers)
    if leading in numbers and (there := shown.get(leading)):
        would = f", where {call_number(there.name)} would be {show(there, factor * numbers[leading])}"
    law = (LAW_GAIN, f"the law's gain ({names}) is declared {times} too {other}{would}", factor)
    yield from (reference, torque, law) if unit else (torque, law, reference)


def _is(factor: float, other: float) -> bool:
    """Whether a factor, or its inverse, is another one."""
    return min(abs(math.log(factor / other)), abs(math.log(factor * other))) < _NEAR


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
    refine=_prefer_known_factor,
)  # fmt: skip
_LAW_BESIDE_INJECTED = replace(LAW_GAIN, meanings=partial(_explain_beside_injected, False))

FAULTS = (GEAR_SIDE, TORQUE_CONSTANT, TORQUE_SCALE, REFERENCE_SCALE, LAW_GAIN)
