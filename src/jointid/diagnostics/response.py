"""Frequency response of an identified joint: from the motor's torque to the velocities of its two sides.

Of the linear part (`model.linear`), moving forwards. Its band is that of the estimate's covariance to first order, of
the logarithm of the response, so that it never passes 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import Joint, frequencies
from jointid.models.linear import OUTPUTS, ComplexArray, frequency_response
from jointid.models.parameters import POSITION_UNIT

_LINES = 400
_LOWEST = 0.1  # Hz
_ABOVE = 3.0  # times the fastest of the three frequencies, at least
_STEP = 1e-6  # of a parameter, or of its deviation where it is 0


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One response with its band.

    Attributes:
        side: "motor" or "load".
        magnitude: (lines,) of the velocity per torque.
        low, high: (lines,) 2 standard deviations about it.
        phase: (lines,) degrees.
    """

    side: str
    magnitude: FloatArray
    low: FloatArray
    high: FloatArray
    phase: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """Frequency response of an identified joint.

    Attributes:
        frequency: (lines,) Hz.
        curves: of the motor, and for a flexible joint of the load.
        unit: of the magnitude.
        modes: Hz by name, of a flexible joint; see `model.joints.frequencies`.
    """

    frequency: FloatArray
    curves: tuple[Curve, ...]
    unit: str
    modes: Mapping[str, float]


def compute_response(estimate: Estimate) -> FrequencyResponse:
    """Return the frequency response of an estimate, with the band of its covariance.

    Raises:
        MethodError: a parameter of the joint is not identifiable.
    """
    joint, values = estimate.settings.joint, estimate.values
    missing = [p.symbol for p in joint.parameters if p.name not in values]
    if missing:
        raise MethodError(f"A frequency response needs every parameter, and {', '.join(missing)} is not identifiable.")
    flexible = joint.model == "flexible"
    modes = frequencies(values) if flexible and values["stiffness"] > 0 else {}
    highest = max(0.5 / estimate.data.sample_time, _ABOVE * max(modes.values(), default=0.0))
    grid = np.geomspace(_LOWEST, highest, _LINES)
    frequency = np.unique(np.concatenate([grid, [f for f in modes.values() if f > _LOWEST]]))
    free = [p for p in estimate.params if p.free and p.of_joint and p.stderr is not None and p.name in values]
    covariance = _select_covariance(estimate, [p.name for p in free])
    at = _compute_velocities(joint, values, frequency)
    slopes = []
    for p in free:
        step = _STEP * (abs(p.value or 0.0) or p.stderr or 1.0)
        moved = _compute_velocities(joint, values | {p.name: values[p.name] + step}, frequency)
        slopes.append([np.log(after / before).real / step for after, before in zip(moved, at, strict=True)])
    curves = []
    for i, (side, H) in enumerate(zip(("motor", "load"), at, strict=False)):
        J = np.array([slope[i] for slope in slopes]).reshape(len(free), frequency.size)
        spread = np.sqrt(np.maximum(np.einsum("pf,pq,qf->f", J, covariance, J), 0.0))
        size, factor = np.abs(H), np.exp(np.minimum(2 * spread, 50.0))
        curves.append(Curve(side, size, size / factor, size * factor, np.degrees(np.unwrap(np.angle(H)))))
    torque_unit = estimate.data.torque_unit
    if " " in torque_unit:
        torque_unit = f"({torque_unit})"
    unit = f"({POSITION_UNIT[joint.kind]}/s)/{torque_unit}"
    return FrequencyResponse(frequency, tuple(curves), unit, modes)


def _compute_velocities(joint: Joint, values: Mapping[str, float], frequency: FloatArray) -> list[ComplexArray]:
    """Return velocity per torque of the motor, and for a flexible joint of the load, (lines,) each."""
    outputs = OUTPUTS[1 : len(OUTPUTS) if joint.model == "flexible" else 2 : 2]
    return [frequency_response(joint, values, frequency, output) for output in outputs]


def _select_covariance(estimate: Estimate, names: list[str]) -> FloatArray:
    """Return the covariance of parameters, (names, names); without correlation where it is not known."""
    free = [p.name for p in estimate.params if p.free]
    chosen = [free.index(name) for name in names]
    std = np.array([estimate[name].stderr for name in names], dtype=np.float64)
    known = max(chosen, default=0) < len(estimate.params.correlation)
    correlation = estimate.params.correlation[np.ix_(chosen, chosen)] if known else np.eye(len(names))
    return np.asarray(np.outer(std, std) * correlation)
