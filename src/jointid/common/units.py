"""Units at the interfaces; all internal values are SI.

`parse_unit` reads products, quotients and powers of units, `parse_quantity` a number with a unit, as ``0.8 A s/rad``.
A joint's *motor unit* is N, N m, or the drive's A or V while the torque constant is unknown; parameters are then per
ampere or volt. `records.drives` converts encoder counts and shares of a rated torque.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from jointid.common.errors import JointidError

Kind: TypeAlias = Literal["prismatic", "revolute"]
"""How a joint, or one side of its transmission, moves."""


class UnitError(JointidError):
    """Unknown or unsuitable unit."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: dimension, factor to SI, SI name, powers; products are unnamed."""

    name: str
    dimension: str
    factor: float
    si: str
    powers: Mapping[str, int]

    def times(self, other: Unit, power: int = 1) -> Unit:
        """Return the product with a power of another unit."""
        bases = dict.fromkeys([*self.powers, *other.powers])
        powers = {base: self.powers.get(base, 0) + power * other.powers.get(base, 0) for base in bases}
        return Unit("", "", self.factor * other.factor**power, "", {base: p for base, p in powers.items() if p})


def _family(dimension: str, si: str, powers: Mapping[str, int], **factors: float) -> dict[str, Unit]:
    names = {name.replace("__", "/").replace("_", " "): factor for name, factor in factors.items()}
    return {name: Unit(name, dimension, factor, si, powers) for name, factor in names.items()}


COUNTS = "encoder counts"
SHARE = "share of the rated torque"

_DEGREE = math.pi / 180
_TURN = 2 * math.pi
_SPEED = {"m": 1, "s": -1}
_RATE = {"rad": 1, "s": -1}
_FORCE = {"kg": 1, "m": 1, "s": -2}
_TORQUE = {"kg": 1, "m": 2, "s": -2}

_UNITS: dict[str, Unit] = {
    **_family("length", "m", {"m": 1}, m=1.0, mm=1e-3, cm=1e-2, um=1e-6, nm=1e-9, inch=0.0254),
    **_family("angle", "rad", {"rad": 1}, rad=1.0, mrad=1e-3, deg=_DEGREE, rev=_TURN, turn=_TURN),
    **_family("linear velocity", "m/s", _SPEED, m__s=1.0, mm__s=1e-3, m__min=1 / 60, mm__min=1e-3 / 60),
    **_family("angular velocity", "rad/s", _RATE, rad__s=1.0, deg__s=_DEGREE, rev__s=_TURN, rpm=_TURN / 60),
    **_family("force", "N", _FORCE, N=1.0, mN=1e-3, kN=1e3, lbf=4.4482216152605),
    **_family("torque", "N m", _TORQUE, N_m=1.0, Nm=1.0, mN_m=1e-3, mNm=1e-3, kN_m=1e3, kNm=1e3, N_cm=1e-2),
    **_family("current", "A", {"A": 1}, A=1.0, mA=1e-3),
    **_family("voltage", "V", {"V": 1}, V=1.0, mV=1e-3),
    **_family(COUNTS, "counts", {"counts": 1}, counts=1.0),
    **_family(SHARE, "rated torque", {"share": 1}, permille=1e-3, per_mille=1e-3, **{"%": 1e-2}),
    **_family("time", "s", {"s": 1}, s=1.0, ms=1e-3, us=1e-6, ns=1e-9, min=60.0, h=3600.0),
    **_family("frequency", "Hz", {"cycle": 1, "s": -1}, Hz=1.0, kHz=1e3),  # 1 Hz and 1 rad/s are not the same
    **_family("mass", "kg", {"kg": 1}, kg=1.0, g=1e-3),
}

POSITION_UNITS = {"prismatic": ("length", COUNTS), "revolute": ("angle", COUNTS)}
VELOCITY_UNITS = {"prismatic": ("linear velocity",), "revolute": ("angular velocity",)}
TORQUE_UNITS = {
    "prismatic": ("force", "current", "voltage", SHARE),
    "revolute": ("torque", "current", "voltage", SHARE),
}


def unit(name: str) -> Unit:
    """Return the unit of that name."""
    if name not in _UNITS:
        raise UnitError(f'"{name}" is no unit that is known; expected one of {", ".join(_UNITS)}.')
    return _UNITS[name]


def units_of(*dimensions: str) -> tuple[str, ...]:
    """Names of all units that measure one of `dimensions`; without any, of all."""
    return tuple(name for name, entry in _UNITS.items() if not dimensions or entry.dimension in dimensions)


_SPELLINGS = {
    "N·m": "N m", "N⋅m": "N m", "N*m": "N m", "N.m": "N m", "newton": "N", "newton metre": "N m", "°": "deg",
    "degree": "deg", "radian": "rad", "°/s": "deg/s", "metre": "m", "meter": "m", "µm": "um", "μm": "um", "µs": "us",
    "μs": "us", "sec": "s", "second": "s", "msec": "ms", "usec": "us", "µsec": "us", "μsec": "us", "nsec": "ns",
    "minute": "min", "hour": "h", "hz": "Hz", "khz": "kHz", "1/min": "rpm", "r/min": "rpm", "RPM": "rpm",
    "rev/min": "rpm", "U/min": "rpm", "min-1": "rpm", "min^-1": "rpm", "U": "rev", "inc": "counts",
    "increment": "counts", "count": "counts", "‰": "permille", "m s-1": "m/s", "rad s-1": "rad/s", "ampere": "A",
    "amp": "A", "volt": "V", "percent": "%", "-": "", "1": "", "none": "",
}  # fmt: skip


def normalise_unit(name: str) -> str:
    """Normalise the spelling of a unit; unknown ones are unchanged."""
    name = name.strip()
    spelt = (name, name.lower(), name.lower().removesuffix("s"))
    return next((_SPELLINGS[one] for one in spelt if one in _SPELLINGS), name)


# Products, quotients and powers

_LONGEST = 100  # characters of a unit
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--")
_MULTIPLIED = str.maketrans("·⋅*×", "    ")
_POINT = re.compile(r"(?<=[^\W\d])\.(?=[^\W\d])")  # between two units, as in N.m
_WORD = re.compile(r"[()/]|[^\s()/]+")
_FACTOR = re.compile(r"(?P<number>\d+)|(?P<name>[^\W\d]+|[°%‰])\^?(?P<power>-?\d+)?")
QUANTITY = re.compile(r"\s*(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?P<unit>.*)", re.DOTALL)


def per(above: str, below: str) -> str:
    """Return the unit of a quotient: "A s/rad" for "A" and "rad/s"."""
    over, stroke, under = below.partition("/")
    if stroke:
        return f"{above} {under}/{over}"
    return above if not below else f"{above}/{f'({below})' if ' ' in below else below}"


def convert(number: float, unit: str, expected: str) -> float | None:
    """Convert a number to another unit; None for one of another dimension.

    Radians are optional, as in N m s for N m s/rad, except beside minutes, where turns may be meant.
    """
    wanted = parse_unit(expected)
    implied = {base: power for base, power in wanted.powers.items() if base != "rad"}
    known = _UNITS.get(normalise_unit(unit))
    for read in filter(None, (known, parse_unit(unit))):
        if read.powers == wanted.powers or (read.powers == implied and "min" not in unit):
            return number * read.factor / wanted.factor
    return None


def parse_quantity(text: str) -> tuple[float, str]:
    """Parse a number with a unit, such as ``0.8 A s/rad``."""
    found = QUANTITY.fullmatch(text)
    if found is None or not found["unit"].strip():
        raise UnitError('expected a number with its unit, as "0.8 A s/rad"')
    parse_unit(found["unit"])
    if not math.isfinite(value := float(found["number"])):
        raise UnitError("the number is too large")
    return value, found["unit"].strip()


def parse_unit(text: str) -> Unit:
    """Parse a product, quotient or power of units.

    Raises:
        UnitError: the text is invalid or has an unknown unit; the message is the rest of a sentence.
    """
    if "," in text:
        raise UnitError("write the number with a decimal point")
    spaced = _POINT.sub(" ", text.translate(_RAISED).translate(_MULTIPLIED).replace("per mille", "permille")).strip()
    if 0 < len(spaced) <= _LONGEST and spaced.count("(") == spaced.count(")"):
        with contextlib.suppress(ValueError, OverflowError, ZeroDivisionError):
            words = iter(_WORD.findall(spaced))
            found = _read_product(words)
            if 0.0 < found.factor < math.inf and next(words, None) is None:
                return found
    raise UnitError(
        f'"{text.strip()[:_LONGEST]}" is no unit; expected products and quotients of units, as A s/rad or A/(rad s)'
    )


def _read_product(words: Iterator[str]) -> Unit:
    """Parse factors up to a closing bracket or the end.

    Raises:
        ValueError: a product or nothing follows a stroke.
    """
    found, power, divided = Unit("", "", 1.0, "", {}), 1, False
    for word in words:
        if word == ")":
            break
        if word == "/":
            power, divided = -power, True
            continue
        if divided and power > 0:
            raise ValueError
        found = found.times(_read_product(words) if word == "(" else _read_factor(word), power)
        power = 1
    if power < 0:
        raise ValueError
    return found


def _read_factor(word: str) -> Unit:
    said = _FACTOR.fullmatch(word)
    if said is None:
        raise ValueError
    if said["number"]:
        return Unit("", "", float(said["number"]), "", {})
    return Unit("", "", 1.0, "", {}).times(unit(normalise_unit(said["name"])), int(said["power"] or 1))
