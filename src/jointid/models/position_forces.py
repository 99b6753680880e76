"""Forces that follow the position: gravity with a known counterbalance, and ripple.

Gravity acts on the load, and on the one inertia of a rigid joint. For a link that turns in a vertical plane, with the
joint's position q on the motor's side and ``angle`` radians of the link per unit of it::

    g(q) = gMX cos(angle q) + gMY sin(angle q)

gMX and gMY are the first moments of the link times g, seen through the transmission: gravity is linear in them whatever
the zero of the position (Khalil and Dombre, Modeling, Identification and Control of Robots, chapter 9). A vertical axis
has a constant load gM. A counterbalance takes ``b0 + bX cos(angle q) + bY sin(angle q) + bK q`` off either.

A ripple is periodic in the position, from a motor's slots, a screw's pitch or a gear's teeth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.common.settings import add_settings_to_docstring, check_settings, declare, setting
from jointid.common.transmission import Side
from jointid.common.units import Kind
from jointid.models.friction import Friction

Load: TypeAlias = Literal["constant", "link"]

_COUNTERBALANCE: Mapping[str, tuple[str, Quantity]] = {
    "constant": ("b0", Quantity.FORCE), "cos": ("bX", Quantity.FORCE), "sin": ("bY", Quantity.FORCE),
    "rate": ("bK", Quantity.FORCE_RATE),
}  # fmt: skip
_FUNCTIONS = tuple(_COUNTERBALANCE)  # 1, cosine and sine of the link's angle, and the position
_LOADS: Mapping[Load, Mapping[str, str]] = {"constant": {"constant": "gM"}, "link": {"cos": "gMX", "sin": "gMY"}}


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion of one side of a joint, each (samples,)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Counterbalance:
    """Known counterbalance force, subtracted from the load: weight, cylinder or spring.

    Raises:
        MethodError: a number is not finite.
    """

    constant: float = setting(0.0, "wherever the joint is", unit="N or N m")
    cos: float = setting(0.0, "times the cosine of the link's angle", unit="N m")
    sin: float = setting(0.0, "times the sine of the link's angle", unit="N m")
    rate: float = setting(0.0, "times the joint's position, of a spring or a cylinder", unit="N/m or N m/rad")

    def __post_init__(self) -> None:
        check_settings(self)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Gravity:
    """The load's gravity on a joint.

    A constant load and the offset of a motor's torque cannot be distinguished by torque and motor position:
    a constant load takes the offset's place, and is the sum of both. Cosine, sine and offset are distinguishable only
    over a long travel of the link, not over a few degrees.

    Raises:
        MethodError: there is no such load, or the angle is 0 or not finite.
    """

    load: Load = field(
        metadata=declare(
            "a vertical axis with a constant load, or a body that turns about a horizontal axis, for a revolute "
            "joint only"
        )
    )
    counterbalance: Counterbalance = setting(
        Counterbalance(),
        "known force of a weight, a spring or a cylinder that carries a part of the load, as the motor sees it; it is "
        "subtracted, and listed with the parameters",
    )
    angle: float = setting(
        1.0,
        "radians of the link per unit of the joint's position: the inverse of the gear ratio, where the position is "
        "the motor's",
        nonzero=True,
    )

    def __post_init__(self) -> None:
        check_settings(self)

    def require(self, kind: Kind, friction: Friction) -> None:
        """Refuse a kind or friction that cannot have this load, by `MethodError`."""
        if kind == "prismatic" and self.turns:
            raise MethodError(
                "A prismatic joint does not turn its load, so nothing of its gravity follows a cosine or a sine; use "
                'load = "constant", or a revolute joint.'
            )
        if self.load == "constant" and friction.two_ways:
            raise MethodError(
                f"A constant load cannot be distinguished from {friction.name} friction: it adds to the Coulomb force "
                "forwards and takes as much from it backwards; use symmetric friction, or leave gravity out."
            )

    @property
    def varies(self) -> bool:
        """True if any part of it depends on the position."""
        return self.turns or self.counterbalance.rate != 0.0

    @property
    def turns(self) -> bool:
        """True if any part of it follows the angle of the link."""
        return self.load == "link" or any((self.counterbalance.cos, self.counterbalance.sin))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the load, then the counterbalance's nonzero numbers, fixed."""
        load = (Parameter(f"gravity_{name}", symbol, Quantity.FORCE) for name, symbol in _LOADS[self.load].items())
        known = (
            Parameter(f"counterbalance_{name}", symbol, quantity).fix(given)
            for name, (symbol, quantity) in _COUNTERBALANCE.items()
            if (given := getattr(self.counterbalance, name)) != 0.0
        )
        return (*load, *known)

    def columns(self, position: FloatArray) -> FloatArray:
        """Return the regressor of the parameters, (samples, parameters), at positions (samples,)."""
        phase = self.angle * position
        functions = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase), position], axis=1)
        return np.column_stack([sign * functions[:, at] for _, at, sign in self._terms])

    def coefficients(self, values: Mapping[str, float]) -> tuple[float, float, float, float]:
        """Coefficients of 1, cosine and sine of the link's angle, and position."""
        total = [0.0] * len(_FUNCTIONS)
        for name, at, sign in self._terms:
            total[at] += sign * values[name]
        constant, cos, sin, rate = total
        return constant, cos, sin, rate

    @property
    def _terms(self) -> list[tuple[str, int, float]]:
        """Name of each parameter, index of its function, and sign."""
        split = ((p.name, p.name.partition("_")) for p in self.parameters)
        return [(name, _FUNCTIONS.index(of), 1.0 if whose == "gravity" else -1.0) for name, (whose, _, of) in split]


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class PositionHarmonics:
    """``sum over k of a_k cos(2 pi k q / period) + b_k sin(2 pi k q / period)``: ripple of a screw, gear or motor.

    A sum of n harmonics of any period lowers the residual of the record it is fitted to; judge it by a cross test.
    """

    in_json = "type"
    period: float = field(
        metadata=declare("of the first harmonic, such as the pitch of a screw", unit="m or rad", above=0)
    )
    harmonics: int = setting(1, "how many, from the first", at_least=1)
    side: Side = setting("motor", "whose position it follows and on which side it acts")

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Cosine and sine amplitudes of each harmonic, in units of torque."""
        prefix, index = ("", "") if self.side == "motor" else ("load_", "2")
        return tuple(
            Parameter(f"{prefix}harmonic_{k}_{word}", f"{letter}{index}_{k}", Quantity.FORCE)
            for k in range(1, self.harmonics + 1)
            for word, letter in (("cosine", "a"), ("sine", "b"))
        )

    def columns(self, position: FloatArray) -> FloatArray:
        """Cosine and sine of each harmonic at positions, (samples, 2 harmonics)."""
        phases = np.outer(position, 2 * math.pi / self.period * np.arange(1, self.harmonics + 1))
        return np.stack([np.cos(phases), np.sin(phases)], axis=2).reshape(len(phases), -1)

    def places(self, values: Mapping[str, float]) -> FloatArray:
        """Position-dependent forces of the harmonics, (harmonics, 5), for simulation in steps."""
        amplitudes = np.array([values[p.name] for p in self.parameters]).reshape(-1, 2)
        waves = 2 * math.pi / self.period * np.arange(1, self.harmonics + 1)
        side = np.full(self.harmonics, float(self.side == "load"))
        return np.column_stack([amplitudes, np.zeros(self.harmonics), waves, side])
