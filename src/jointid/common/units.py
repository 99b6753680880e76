"""Units at the edges: everything inside is SI, and every number that comes in or goes out names its unit.

A unit is a name, a dimension and a factor to SI. A joint's *motor unit* is the unit its torque is kept in: N or
N m, or the drive's own A or V while the torque constant is unknown; parameters then come per ampere or per volt.
Encoder counts and shares of a rated torque are units of one drive; `data.drive` takes them to SI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from jointid.common.errors import JointidError

Kind: TypeAlias = Literal["prismatic", "revolute"]
"""How a joint, or one side of its transmission, moves."""


class UnitError(JointidError):
    """A unit that is not known, or not one for this quantity."""


@dataclass(frozen=True, slots=True)
class Unit:
    """One unit: its name, the dimension it measures and the factor that takes a value to SI."""

    name: str
    dimension: str
    factor: float
    si: str


class DriveUnits(Protocol):
    """What resolves a drive's own units: counts of its encoder, shares of its rated torque."""

    def resolve_unit(self, unit: Unit, kind: str) -> Unit:
        """Return a unit with its factor to SI, for a side of that kind of motion.

        Raises:
            UnitError: a number of the drive is missing.
        """


def _family(dimension: str, si: str, **factors: float) -> dict[str, Unit]:
    names = {name.replace("__", "/").replace("_", " "): factor for name, factor in factors.items()}
    return {name: Unit(name, dimension, factor, si) for name, factor in names.items()}


COUNTS = "encoder counts"
SHARE = "share of the rated torque"

_DEGREE = math.pi / 180
_TURN = 2 * math.pi

_UNITS: dict[str, Unit] = {
    **_family("length", "m", m=1.0, mm=1e-3, cm=1e-2, um=1e-6, nm=1e-9, inch=0.0254),
    **_family("angle", "rad", rad=1.0, mrad=1e-3, deg=_DEGREE, rev=_TURN, turn=_TURN),
    **_family("linear velocity", "m/s", m__s=1.0, mm__s=1e-3, m__min=1 / 60, mm__min=1e-3 / 60),
    **_family("angular velocity", "rad/s", rad__s=1.0, deg__s=_DEGREE, rev__s=_TURN, rpm=_TURN / 60),
    **_family("force", "N", N=1.0, mN=1e-3, kN=1e3, lbf=4.4482216152605),
    **_family("torque", "N m", N_m=1.0, Nm=1.0, mN_m=1e-3, mNm=1e-3, kN_m=1e3, kNm=1e3, N_cm=1e-2),
    **_family("current", "A", A=1.0, mA=1e-3),
    **_family("voltage", "V", V=1.0, mV=1e-3),
    **_family(COUNTS, "counts", counts=1.0),
    **_family(SHARE, "rated torque", permille=1e-3, per_mille=1e-3, **{"%": 1e-2}),
    **_family("time", "s", s=1.0, ms=1e-3, us=1e-6, ns=1e-9, min=60.0, h=3600.0),
}

POSITION_UNITS = {"prismatic": ("length", COUNTS), "revolute": ("angle", COUNTS)}
VELOCITY_UNITS = {"prismatic": ("linear velocity",), "revolute": ("angular velocity",)}
TORQUE_UNITS = {
    "prismatic": ("force", "current", "voltage", SHARE),
    "revolute": ("torque", "current", "voltage", SHARE),
}


def unit(name: str) -> Unit:
    """Return the unit of that name.

    Raises:
        UnitError: the name is not in the table; the sentence lists the names there are.
    """
    try:
        return _UNITS[name]
    except KeyError:
        known = ", ".join(_UNITS)
        raise UnitError(f'Unit "{name}" is not known; use one of {known}.') from None


def units_of(*dimensions: str) -> tuple[str, ...]:
    """Return the names of all units that measure one of `dimensions`."""
    return tuple(name for name, entry in _UNITS.items() if entry.dimension in dimensions)


_SPELLINGS = {
    "N·m": "N m", "N⋅m": "N m", "N*m": "N m", "N.m": "N m", "newton": "N", "newtons": "N", "newton metre": "N m",
    "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "°/s": "deg/s",
    "metre": "m", "metres": "m", "meter": "m", "meters": "m", "µm": "um", "μm": "um", "µs": "us", "μs": "us",
    "sec": "s", "second": "s", "seconds": "s", "1/min": "rpm", "r/min": "rpm", "RPM": "rpm",
    "m s-1": "m/s", "rad s-1": "rad/s", "ampere": "A", "amperes": "A", "volt": "V", "volts": "V", "count": "counts",
    "percent": "%", "-": "", "1": "", "none": "",
}  # fmt: skip


def spelled(name: str) -> str:
    """Return the name in the table of a unit that a file spells in another way; any other as it is, "" for none."""
    name = name.strip()
    return _SPELLINGS.get(name, _SPELLINGS.get(name.lower(), name))
