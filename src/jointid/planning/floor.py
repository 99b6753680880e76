"""Lower bound of a goal's deviation for flexible joints, and its spectrum.

A sliding flexible joint is linear, so information adds up over frequencies. With P the response of the motor's position
to the force on it, H the controller's torque per position, S = 1 / (1 + P H exp(-s d)) and F the force, the torque's
derivative by a parameter is ``-H S dP/dp F``, and the information is::

    M = N sum_f |F(f)|^2 Re(g* g') / s(f),       g = H S dP/dp

with N samples and the noise's spectrum s(f): of the log ``log^2``, of a force ``force^2 |H P S|^2``. The variance of a
combination w, ``w' M^-1 w``, is convex in the powers ``|F|^2``. Constraints are the torque's mean square and half of
the stroke. The bound is optimistic: friction is known, the joint never sticks, all frequencies up to the cut-off are
free, and torque peaks are not limited. Coulomb friction takes ``(Fc1 + Fc2)^2`` of the mean square torque, which holds
for a moving axis, not for one that rests or rings about a stop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.joints import ClosedLoop
from jointid.models.limits import AxisLimits
from jointid.models.linear import ComplexArray, frequency_response
from jointid.planning.predict import Goal, Noise

_LINES = 120  # frequencies
_STEP = 1e-6  # relative, of the differences by which P is differentiated
_PARAMETERS = ("motor_inertia", "motor_viscous", "stiffness", "damping", "load_inertia", "load_viscous")
_STEPS = 400  # of the search for the powers
_LEFT = 0.1  # of a signal that is injected, at least
_CLOSE = 0.08  # of the logarithm of a frequency
_OF_ALL = 0.02  # of the power: frequencies with less matter little


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """The least deviation over all motions, and the optimal force powers.

    Attributes:
        deviation: of the goal; None if unknown.
        hertz, power: (frequencies,) frequencies of the acting force, and its mean square at each.
        sensitivity: (frequencies,) |S|, the share of an injected signal that acts as a force.
    """

    deviation: float | None
    hertz: FloatArray
    power: FloatArray
    sensitivity: FloatArray

    @property
    def lines(self) -> tuple[tuple[float, float], ...]:
        """Dominant frequencies, Hz, with amplitudes to inject relative to the largest.

        Neighbouring frequencies are merged. The reference has to compensate for the loop.
        """
        left = np.where(self.sensitivity > _LEFT, self.power, 0.0)
        found = []
        while left.max() > _OF_ALL * np.sum(self.power):
            strongest = self.hertz[int(np.argmax(left))]
            near = np.abs(np.log(self.hertz / strongest)) < _CLOSE
            middle = float(np.exp(np.average(np.log(self.hertz[near]), weights=left[near])))
            found.append((middle, math.sqrt(float(np.sum(left[near] / self.sensitivity[near] ** 2)))))
            left = np.where(near, 0.0, left)
        found.sort()
        largest = max((size for _, size in found), default=1.0)
        return tuple((f, size / largest) for f, size in found)


def least_deviation(
    loop: ClosedLoop, values: Mapping[str, float], noise: Noise, goal: Goal, limits: AxisLimits, samples: int,
    sample_time: float, cutoff: float,
) -> Floor | None:  # fmt: skip
    """Lower bound of a goal's standard deviation for a flexible joint.

    None with another friction or spring law, for a goal that is no combination of the linear parameters, and if the
    torque is unlimited or does not move the joint.

    Args:
        loop: joint and controller.
        values: every parameter of the joint by name.
        noise: of the log, or of a force. For a first record's noise or the goal "all" the deviation is unknown; the
            powers are then those for an equal force and the stiffness.
        goal: a linear parameter, a combination of them, or "all".
        limits: of torque (rms) and stroke.
        samples: of the test.
        sample_time: of its log, s.
        cutoff: of the filter, Hz.
    """
    power, weights = limits.rms_torque or limits.torque, goal.weights or {"stiffness": 1.0}
    if power is None or not values.keys() >= set(_PARAMETERS) or not weights.keys() <= set(_PARAMETERS):
        return None
    friction = values["motor_coulomb"] + values["load_coulomb"]
    if power <= friction:
        return None
    hertz = np.geomspace(limits.lowest, cutoff, _LINES)
    law = loop.controller.law(sample_time)

    def respond(name: str, by: float) -> ComplexArray:
        """Response of the sliding motor's position to a force on it."""
        return frequency_response(loop.joint, {**values, name: values[name] + by}, hertz, "motor_position")

    H, P = -law.feedback(hertz), respond("stiffness", 0.0)
    S = 1 / (1 + P * H * np.exp(-2j * math.pi * hertz * (law.delay + 0.5 * law.period)))
    steps = {name: _STEP * (abs(values[name]) or 1.0) for name in _PARAMETERS}
    slopes = [(respond(name, by) - respond(name, -by)) / (2 * by) for name, by in steps.items()]
    g = H * S * np.array(slopes)
    force = noise.force if noise.left is None else float(np.sqrt(np.mean(noise.left**2)))
    spectrum = noise.log**2 + force**2 * np.abs(H * P * S) ** 2
    information = samples * np.real(np.conj(g)[:, np.newaxis] * g[np.newaxis]) / spectrum  # (parameters, parameters, f)
    most, square = power**2 - friction**2, np.abs(P) ** 2
    allowed = np.vstack([np.full(hertz.size, 1 / most), square / (0.5 * limits.stated.get("stroke", math.inf)) ** 2])
    variance, found = _least_variance(information, allowed, np.array([weights.get(name, 0.0) for name in _PARAMETERS]))
    known = noise.left is None and goal.weights
    return Floor(math.sqrt(variance) if known else None, hertz, found, np.abs(S))


def _least_variance(information: FloatArray, allowed: FloatArray, w: FloatArray) -> tuple[float, FloatArray]:
    """Minimise ``w' M^-1 w`` over powers with ``allowed @ power <= 1``.

    S. D. Silvey's multiplicative rule: scale each power by the root of its gain, then normalise to the active
    constraint.
    """
    sizes = np.sqrt(np.maximum(np.diag(np.sum(information, axis=2)), 1e-300))
    information = information / np.outer(sizes, sizes)[:, :, np.newaxis]
    w = w / sizes
    power = np.full(information.shape[2], 1.0)
    best, kept = math.inf, power
    price = np.array([1.0, 0.0])
    for _ in range(_STEPS):
        power = power / max(float(np.max(allowed @ power)), 1e-300)
        M = information @ power
        solved = np.linalg.lstsq(M, w, rcond=1e-14)[0]
        variance = float(w @ solved)
        if variance < best:
            best, kept = variance, power
        gain = np.einsum("i,ijf,j->f", solved, information, solved)
        used = allowed @ power
        # What binds costs; the price moves until both are used up, or one is not needed.
        price = np.maximum(price * np.exp(0.5 * (used - 1.0)), 1e-6)
        price = price / price.sum()
        power = power * np.sqrt(np.maximum(gain, 0.0) / np.maximum(price @ allowed, 1e-300))
    return best, kept
