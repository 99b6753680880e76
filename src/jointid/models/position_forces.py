"""Forces that follow the position: gravity with a known counterbalance, and ripple.

Gravity acts on the load, and on the one inertia of a rigid joint. For a link that turns in a vertical plane, with the
joint's position q on the motor's side and ``angle`` radians of the link per unit of it::

    g(q) = gMX cos(angle q) + gMY sin(angle q)

gMX and gMY are the first moments of the link times g, seen through the transmission: gravity is linear in them whatever
the zero of the position (Khalil and Dombre, Modeling, Identification and Control of Robots, chapter 9). A vertical axis
has a constant load gM. A counterbalance takes ``b0 + bX cos(angle q) + bY sin(angle q) + bK q`` off either.

A ripple comes back with the position, of a motor's slots, a screw's pitch or a gear's teeth.
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

_TERMS: Mapping[str, tuple[str, Quantity]] = {
    "constant": ("0", Quantity.FORCE),
    "cos": ("X", Quantity.FORCE),
    "sin": ("Y", Quantity.FORCE),
    "rate": ("K", Quantity.FORCE_RATE),
}
_LOADS: Mapping[Load, Mapping[str, str]] = {"constant": {"constant": "gM"}, "link": {"cos": "gMX", "sin": "gMY"}}
_STEPS = 8  # to where a load hangs: Newton squares the error in each


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion of one side of a joint, each (samples,)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Counterbalance:
    """The force that a known counterbalance takes off the load: a weight, a cylinder or a spring.

    Raises:
        MethodError: a number is not finite.
    """

    constant: float = setting(0.0, "wherever the joint is", unit="N or N m")
    cos: float = setting(0.0, "times the cosine of the link's angle", unit="N m")
    sin: float = setting(0.0, "times the sine of the link's angle", unit="N m")
    rate: float = setting(0.0, "times the joint's position, of a spring or a cylinder", unit="N/m or N m/rad")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class _Term:
    """One parameter, and which of the functions of the position it is the factor of."""

    parameter: Parameter
    term: int
    sign: float


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Gravity:
    """The load's gravity on a joint.

    A constant load and the offset of a motor's torque cannot be distinguished by torque and motor position:
    a constant load takes the offset's place, and is the sum of both. The cosine, the sine and the offset are three
    functions only where the link travels far: over a few degrees nothing tells one from the other.

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
        "the known force of a weight, a spring or a cylinder that carries a part of the load, seen by the motor; it "
        "is taken off, and listed with the parameters",
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
        """Raise a `MethodError` if a joint of that kind and friction cannot have this load."""
        turning = self.load == "link" or self.counterbalance.cos != 0.0 or self.counterbalance.sin != 0.0
        if kind == "prismatic" and turning:
            raise MethodError(
                "A prismatic joint does not turn its load, so nothing of its gravity follows a cosine or a sine; use "
                'load = "constant", or a revolute joint.'
            )
        if self.load == "constant" and not friction.offset_identifiable:
            raise MethodError(
                f"A constant load cannot be distinguished from {friction.name} friction: it adds to the Coulomb force "
                "forwards and takes as much from it backwards; use symmetric friction, or leave gravity out."
            )

    @property
    def varies(self) -> bool:
        """True if any part of it depends on the position."""
        return self.load == "link" or any((self.counterbalance.cos, self.counterbalance.sin, self.counterbalance.rate))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Weight of the load, then the counterbalance's numbers other than 0, which are fixed."""
        return tuple(one.parameter for one in self._terms)

    def columns(self, position: FloatArray) -> FloatArray:
        """Return the regressor of the parameters, (samples, parameters), at positions (samples,)."""
        phase = self.angle * position
        functions = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase), position], axis=1)
        return np.column_stack([one.sign * functions[:, one.term] for one in self._terms])

    def coefficients(self, values: Mapping[str, float]) -> tuple[float, float, float, float]:
        """Return the factors of 1, of the cosine and the sine of the link's angle, and of the position."""
        total = [0.0] * len(_TERMS)
        for one in self._terms:
            total[one.term] += one.sign * values[one.parameter.name]
        constant, cos, sin, rate = total
        return constant, cos, sin, rate

    def static_deflection(self, values: Mapping[str, float], stiffness: float, position: float, drag: float) -> float:
        """Return the spring's static deflection under gravity and drag, the motor at `position`: by Newton's method.

        A load that gravity pushes over faster than the spring rights it hangs nowhere; the result then means nothing.
        """
        constant, cos, sin, rate = self.coefficients(values)
        found = (drag + constant) / stiffness
        for _ in range(_STEPS):
            load = position - found
            x, y = math.cos(self.angle * load), math.sin(self.angle * load)
            missing = drag + constant + cos * x + sin * y + rate * load - stiffness * found
            slope = self.angle * (sin * x - cos * y) + rate
            found += missing / max(stiffness + slope, 0.5 * stiffness)
        return found

    @property
    def _terms(self) -> tuple[_Term, ...]:
        names = list(_TERMS)
        load = [
            _Term(Parameter(f"gravity_{name}", symbol, Quantity.FORCE), names.index(name), 1.0)
            for name, symbol in _LOADS[self.load].items()
        ]
        known = [
            _Term(Parameter(f"counterbalance_{name}", f"b{index}", quantity).fix(given), names.index(name), -1.0)
            for name, (index, quantity) in _TERMS.items()
            if (given := getattr(self.counterbalance, name)) != 0.0
        ]
        return (*load, *known)


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
        """Amplitude of cosine and sine of each harmonic, in the unit of the torque."""
        prefix, index = ("", "") if self.side == "motor" else ("load_", "2")
        return tuple(
            Parameter(f"{prefix}harmonic_{k}_{word}", f"{letter}{index}_{k}", Quantity.FORCE)
            for k in range(1, self.harmonics + 1)
            for word, letter in (("cosine", "a"), ("sine", "b"))
        )

    def columns_at(self, position: FloatArray) -> FloatArray:
        """Return cosine and sine of each harmonic at positions, (samples,): (samples, 2 harmonics)."""
        phases = np.outer(position, 2 * math.pi / self.period * np.arange(1, self.harmonics + 1))
        return np.stack([np.cos(phases), np.sin(phases)], axis=2).reshape(len(phases), -1)

    def require(self, model: str) -> None:
        """Raise a `MethodError` if a joint of that model cannot be simulated with it."""
        if model == "rigid" and self.side == "load":
            raise MethodError('A rigid joint has no load side of its own; use side = "motor".')

    def places(self, values: Mapping[str, float]) -> FloatArray:
        """Return it as forces that follow a position, (harmonics, 5), for the simulation in steps."""
        amplitudes = np.array([values[p.name] for p in self.parameters]).reshape(-1, 2)
        waves = 2 * math.pi / self.period * np.arange(1, self.harmonics + 1)
        side = np.full(self.harmonics, float(self.side == "load"))
        return np.column_stack([amplitudes, np.zeros(self.harmonics), waves, side])
