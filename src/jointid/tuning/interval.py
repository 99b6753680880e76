"""The joints that an estimate allows, and the worst margins among them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Quantity
from jointid.common.text import number
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import SampledLaw
from jointid.models.joints import Joint
from jointid.tuning.margins import JointSet, joint_set

_MOVES = (Quantity.INERTIA, Quantity.VISCOUS, Quantity.STIFFNESS)
_LEAST = 1e-3  # of an inertia or a stiffness: what an interval reaches at least, since without it there is no mode
_DIRECTIONS = 40  # random ones for each parameter


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Possible joints of an estimate.

    If every parameter is significant, these are the joints of the confidence ellipsoid of the parameters that move the
    loop (inertias, viscous frictions, spring and damper)::

        (x - x0)' C^-1 (x - x0) <= q,    q the quantile of chi-square with as many degrees of freedom as parameters

    It holds all parameters together, so any number of margins hold together with at least this confidence, also for
    loops designed from the same record.

    Attributes:
        nominal: the parameters of the estimate, by name.
        names: of the parameters that span the ellipsoid, factor: (names, names) from a unit ball to it, lower: bounds.
        description: what it is, in a sentence.
    """

    joint: Joint
    nominal: Mapping[str, float]
    names: tuple[str, ...]
    factor: FloatArray
    lower: FloatArray
    description: str

    def at(self, points: FloatArray) -> list[Mapping[str, float]]:
        """Return the joints at points of the unit ball, (points, names)."""
        center = np.array([self.nominal[name] for name in self.names])
        values = np.maximum(center + points @ self.factor.T, self.lower)
        return [dict(self.nominal) | dict(zip(self.names, map(float, row), strict=True)) for row in values]

    def sample(self, points: FloatArray, law: SampledLaw) -> JointSet:
        """Sample the joints for a law, at points of the unit ball, (points, names)."""
        return joint_set(self.joint, self.at(points), law)

    def points(self, seed: int) -> FloatArray:
        """Centre, both ends of every axis and random surface points, (points, names)."""
        count = len(self.names)
        if not count:
            return np.zeros((1, 0))
        drawn = np.random.default_rng(seed).standard_normal((_DIRECTIONS * count, count))
        drawn /= np.linalg.norm(drawn, axis=1)[:, np.newaxis]
        return np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count), drawn])

    def find_worst(self, law: SampledLaw, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find the worst margins at given points, and where each falls most steeply.

        Returns:
            The smallest of each margin, (5,), and the points of the unit ball with it, (found, names).
        """
        margins = self.sample(points, law).margins(law)
        for _ in range(2):  # the second slope is that of more points near the worst
            if len(more := _find_downhill(points, margins)):
                margins = np.concatenate([margins, self.sample(more, law).margins(law)])
                points = np.concatenate([points, more])
        return np.min(margins, axis=0), points[np.unique(np.argmin(margins, axis=0))]


def possible_joints(estimate: Estimate, confidence: float) -> Interval:
    """Determine the joints that an estimate allows.

    Args:
        estimate: with deviations and correlations.
        confidence: of all its parameters together.

    Raises:
        MethodError: the estimate has no deviations or no correlations.
    """
    joint, values = estimate.settings.joint, estimate.identified.values
    free = [p.name for p in estimate.params.rows if p.free]
    moving = {p.name: p for p in joint.parameters if p.quantity in _MOVES}
    chosen = [p for p in estimate.params.rows if p.name in moving and p.free]
    at = [free.index(p.name) for p in chosen]
    if any(p.stderr is None for p in chosen) or max(at, default=-1) >= len(estimate.params.correlation):
        raise MethodError(
            "Margins over an interval need the deviations of the parameters and their correlation, and this estimate "
            f"of {estimate.data.record} has none; identify by least squares."
        )
    std = np.array([p.stderr for p in chosen], dtype=np.float64)
    radius = ellipsoid_radius(len(chosen), confidence)
    size, axes = np.linalg.eigh(estimate.params.correlation[np.ix_(at, at)])
    factor = radius * std[:, np.newaxis] * axes * np.sqrt(np.maximum(size, 0.0))
    lower = [
        max(moving[p.name].lower, 0.0) if moving[p.name].quantity is Quantity.VISCOUS else _LEAST * values[p.name]
        for p in chosen
    ]
    symbols = ", ".join(p.symbol for p in chosen)
    description = (
        f"the {100 * confidence:g} % confidence ellipsoid of {symbols} together: {number(radius, 3)} standard "
        "deviations in every direction"
    )
    return Interval(joint, values, tuple(p.name for p in chosen), factor, np.array(lower), description)


def ellipsoid_radius(parameters: int, confidence: float) -> float:
    """Return the radius of a confidence ellipsoid in standard deviations."""
    from scipy.special import gammaincinv

    return math.sqrt(2.0 * float(gammaincinv(parameters / 2.0, confidence))) if parameters else 0.0


def _find_downhill(points: FloatArray, margins: FloatArray) -> FloatArray:
    """Return, for every margin, the surface point at which its linear part is smallest."""
    found = []
    for one in margins.T:
        stable = np.isfinite(one) & (margins[:, -1] > 0)
        if np.sum(stable) <= points.shape[1] + 1:
            continue
        columns = np.column_stack([np.ones(int(np.sum(stable))), points[stable]])
        slope = np.linalg.lstsq(columns, one[stable], rcond=None)[0][1:]
        if size := float(np.linalg.norm(slope)):
            found.append(-slope / size)
    return np.array(found).reshape(-1, points.shape[1])
