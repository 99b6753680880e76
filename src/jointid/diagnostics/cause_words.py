"""What is said of a cause: its code, its number, and a sentence.

One factor of the whole loop's gain has several causes, which no record tells apart. The factor itself is a hint: 57.3
is an angle in degrees, 1000 a length in mm, a gear's ratio or its square the wrong side of the gear.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from jointid.common.text import number
from jointid.diagnostics.hypotheses import UNITS, Cause, gear_ratio
from jointid.diagnostics.number_words import call, show, show_times_beside
from jointid.models.controllers import numbers_of
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import ClosedLoop

_NO_TIME = 1e-6  # s
_NEAR = 0.08  # a factor is taken for another one that is so near
_UNIT_SLIP = 1000.0  # s for ms
_BOTH_GAINS = "position gain and torque (or velocity gain) are both off by that factor"
_ROUGHLY = 2.0  # times: a gain that is found so near to a unit's factor is off by that


@dataclass(frozen=True, slots=True)
class Explanation:
    """A cause that explains a record.

    Attributes:
        cause: its code.
        words: what is wrong.
        value: what a number should be declared as, in the unit of the declaration, or of the record's factors by how
            much it is too large; None where no number is wrong.
        error: share of the filtered torque that is left with it put right.
    """

    cause: Cause
    words: str
    value: float | None
    error: float


def tell(
    cause: Cause, value: float | None, error: float, loop: ClosedLoop, shown: Iterable[DriveNumber] = ()
) -> tuple[Explanation, ...]:
    """Return what a hypothesis that was put right stands for: several causes where no record tells them apart.

    Args:
        cause: of the hypothesis.
        value: of its number, where it has one.
        error: that is left.
        loop: as it is declared.
        shown: how the drive shows the numbers of the controller; without it they are told as they are here.
    """
    numbers, known = numbers_of(loop.controller), {one.number: one for one in shown}
    if cause is Cause.LAW_GAIN:
        assert value is not None
        factor = value / numbers["gain"]
        return tuple(Explanation(c, words, by, error) for c, words, by in _of_gain(factor, loop, known))
    if cause is Cause.TORQUE_SIGN:
        return (
            Explanation(cause, "the torque has the wrong sign", None, error),
            Explanation(Cause.REFERENCE_SIGN, "the reference has the wrong sign", None, error),
        )
    alone = Explanation(cause, _words(cause, value, loop, known), value, error)
    if cause is Cause.SAMPLE_TIME and "velocity_gain" in numbers:
        # u = g (Kv e - v): with all velocities f times as large it is the law with Kv f times as large, and g f times
        # as small. Only filters and delays tell the two apart, hardly.
        return alone, Explanation(Cause.LAW_GAIN, _BOTH_GAINS, None, error)
    return (alone,)


def _of_gain(factor: float, loop: ClosedLoop, shown: Mapping[str, DriveNumber]) -> Iterator[tuple[Cause, str, float]]:
    """Yield the causes of a loop whose gain is so many times the declared one, the likeliest first."""
    controller: Any = loop.controller
    times = _times(factor)
    ratio = gear_ratio(loop)
    told = []
    if ratio != 1.0 and _is(factor, ratio):
        told.append((Cause.GEAR_SIDE, _of_side(factor, ratio), factor))
    elif ratio != 1.0 and _is(factor, ratio**2):
        words = f"the controller is on the wrong side of the {ratio:g}:1 gear (side of [controller]), or torque and "
        told.append((Cause.GEAR_SIDE, f"{words}reference are both", factor))
    constant = getattr(controller, "gain", 1.0)
    if constant != 1.0 and _is(factor, constant):
        told.append(
            (Cause.TORQUE_CONSTANT, f"the torque constant ({constant:g}) is applied twice, or not at all", factor)
        )
    size = "large" if factor > 1 else "small"
    other = "small" if factor > 1 else "large"
    torque = (Cause.TORQUE_SCALE, f"the torque is {times} too {size}", factor)
    if there := shown.get("torque_constant"):
        assert there.declared is not None
        would, said = number(there.declared / factor, 3), number(there.declared, 3)
        would = f"torque_constant below [joint] would be {would}, not {said}"
        torque = (Cause.TORQUE_CONSTANT, f"{torque[1]}: {would} {there.unit}", factor)
    unit = next((unit for unit, by in UNITS.items() if factor < 1 and _is(factor, by)), "")
    by_gear = "" if ratio == 1.0 or told else f", as by another gear than {ratio:g}:1"
    reference = (Cause.REFERENCE_SCALE, f"the reference is {unit or f'{times} too {other}{by_gear}'}", 1 / factor)
    numbers = numbers_of(controller)
    leading = _leading_gain(numbers, shown)
    names = " or ".join(name for name in (leading, "gain") if name in numbers)
    would = ""
    if leading and (there := shown.get(leading)):
        would = f", where {call(there.name)} would be {show(there, factor * numbers[leading], numbers)}"
    law = (Cause.LAW_GAIN, f"the law's gain ({names}) is declared {times} too {other}{would}", factor)
    yield from told
    yield from (reference, torque, law) if unit else (torque, law, reference)


def _leading_gain(numbers: Mapping[str, float], shown: Mapping[str, DriveNumber]) -> str | None:
    """Return the gain to which a law's whole output is proportional as its drive shows it; None where none is."""
    if "velocity_gain" in numbers:
        return "velocity_gain"
    others = [name for name in ("derivative_gain", "integral_gain") if numbers.get(name)]
    as_times = others and all(name in shown and shown[name].per == "position_gain" for name in others)
    return "position_gain" if as_times else None


def _of_side(factor: float, ratio: float) -> str:
    """Return that a channel is on the wrong side of the gear, and which side it is on."""
    there, read = ("load", "motor") if (factor > 1) is (ratio > 1) else ("motor", "load")
    return (
        f"the reference, or the torque, is on the wrong side of the {ratio:g}:1 gear: it is the {there}'s and read as "
        f'the {read}\'s (give its channel side = "{there}")'
    )


def _is(factor: float, other: float) -> bool:
    """Whether a factor, or its inverse, is another one."""
    return min(abs(math.log(factor / other)), abs(math.log(factor * other))) < _NEAR


def _times(factor: float) -> str:
    return f"about {number(max(factor, 1 / factor), 2)} times"


def _milliseconds(seconds: float) -> str:
    """Return a time in ms; one that no drive keeps is none."""
    return "0" if abs(seconds) < _NO_TIME else number(1e3 * seconds, 2)


def _words(cause: Cause, value: float | None, loop: ClosedLoop, shown: Mapping[str, DriveNumber]) -> str:
    """Return a cause that has one meaning only, in words."""
    controller: Any = loop.controller
    if value is None:
        integral = call(shown["integral_gain"].name if "integral_gain" in shown else "integral gain")
        there = "not there" if getattr(controller, "velocity_feedforward", 0.0) else "not declared"
        ahead = f"the velocity feed-forward is {there}"
        if not hasattr(controller, "velocity_feedforward"):
            reads = "reads" if controller.reference_velocity == "none" else "does not read"
            ahead = f"the law {reads} the reference's velocity"
        other = "velocity" if hasattr(controller, "velocity_gain") else "derivative"
        return {
            Cause.SWAPPED_CHANNELS: "torque and reference are swapped",
            Cause.SWAPPED_GAINS: f"position gain and {other} gain are swapped",
            Cause.REFERENCE_IS_POSITION: "the channel given as the reference is the motor's actual position",
            Cause.INTEGRAL: f"{integral.replace('the ', 'the declared ', 1)} is not there",
            Cause.VELOCITY_FILTER: "the declared velocity filter is not there",
            Cause.VELOCITY_FEEDFORWARD: ahead,
        }[cause]
    if cause is Cause.SAMPLE_TIME:
        return f"the sample time is {_times(value)} too {'short' if value > 1 else 'long'}"
    if cause in _GAINS:
        return _of_number(_GAINS[cause], value, controller, shown)
    if cause is Cause.PERIOD:
        return f"the controller runs faster than the log: declare its period, about {1e3 * value:.4g} ms"
    if cause is Cause.FLEXIBLE:
        return f'the joint is flexible (model = "flexible"), with a mode near {number(value, 2)} Hz'
    numbers, ms = numbers_of(controller), _milliseconds(value)
    filtered, by_cutoff = f"{ms} ms", shown.get("velocity_filter.time_constant")
    if by_cutoff is not None and by_cutoff.inverse and value >= _NO_TIME:
        filtered = show(by_cutoff, value, numbers)
    return {
        Cause.VELOCITY_FILTER: f"the velocity filter is another one, such as one of first order with {filtered}",
        Cause.TORQUE_FILTER: f"there is one more torque filter, such as one of first order with {ms} ms",
        Cause.DELAY: f"the delay is about {ms} ms, not {_milliseconds(numbers.get('delay', 0.0))} ms",
        Cause.REFERENCE_DELAY: f"the law sees the reference about {ms} ms late",
    }[cause]


_GAINS = {
    Cause.POSITION_GAIN: "position_gain",
    Cause.DERIVATIVE_GAIN: "derivative_gain",
    Cause.INTEGRAL: "integral_gain",
}


def _of_number(name: str, value: float, controller: Any, shown: Mapping[str, DriveNumber]) -> str:
    """Return that a gain is another one than declared, as the drive shows both, and the unit that may be mistaken."""
    there = shown.get(name) or DriveNumber(name, name, "", 1.0)
    law = numbers_of(controller)
    declared = law.get(name) or 0.0
    words = f"{call(there.name)} is about {show(there, value, law)}"
    if not declared:
        return f"{words}, and is not declared"
    words += f", not {show(there, declared, law)}"
    words += show_times_beside(name, value, law, shown.values())
    factor = value / declared
    of_a_unit = abs(math.log(max(factor, 1 / factor) / _UNIT_SLIP)) < math.log(_ROUGHLY)
    if name != "integral_gain" or not of_a_unit:
        return words
    less = (factor > 1) is there.inverse  # a time is so much shorter as its gain is larger
    meant, read = ("ms", "s") if factor > 1 else ("s", "ms")
    whose = "its unit" if there.inverse else "the unit of the integral time"
    return f"{words}: about 1000 times {'less' if less else 'more'}; {whose} may be {meant}, not {read}"
