"""Possible joints of an estimate, and the worst of them.

If every parameter is significant, these are the joints of the confidence ellipsoid of the parameters that move the loop
(inertias, viscous frictions, spring and damper)::

    (x - x0)' C^-1 (x - x0) <= q,    q the quantile of chi-square with as many degrees of freedom as parameters

It holds all parameters together, so that any number of margins hold together with at least this confidence, also for
loops designed from the same record. A refused stiffness gives all springs above its bound.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Quantity
from jointid.common.text import number
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import SampledLaw
from jointid.models.joints import MODE_DAMPING, FlexibleJoint, Joint, split_by_mode
from jointid.tuning.margins import JointSet, joint_set

_MOVES = (Quantity.INERTIA, Quantity.VISCOUS, Quantity.STIFFNESS)
_LEAST = 1e-3  # of an inertia or a stiffness: what an interval reaches at least, since without it there is no mode
_DIRECTIONS = 20  # random ones for each parameter
_SPRINGS = 30  # tried between a bound and half the sampling frequency
_ROUNDS = 4  # of the search for a worse joint
_NEAR = 6  # joints tried around the worst one, for every margin
_TURNED = 0.3  # how far these are from it, in the unit ball


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """The possible joints.

    Attributes:
        nominal: the parameters of the estimate, or of the softest spring, by name.
        names: of the parameters that span the ellipsoid, factor: (names, names) from a unit ball to it, lower: bounds.
        others: joints beside it: those of a spring that is refused.
        description: what it is, in a sentence.
    """

    joint: Joint
    nominal: Mapping[str, float]
    names: tuple[str, ...]
    factor: FloatArray
    lower: FloatArray
    others: tuple[Mapping[str, float], ...]
    description: str

    def at(self, points: FloatArray) -> list[Mapping[str, float]]:
        """Return the joints at points of the unit ball, (points, names)."""
        center = np.array([self.nominal[name] for name in self.names])
        values = np.maximum(center + points @ self.factor.T, self.lower)
        return [dict(self.nominal) | dict(zip(self.names, map(float, row), strict=True)) for row in values]

    def sample(self, points: FloatArray, law: SampledLaw) -> JointSet:
        """Sample the joints for a law, at points of the unit ball, (points, names), and besides."""
        return joint_set(self.joint, [*self.at(points), *self.others], law)

    def points(self, seed: int) -> FloatArray:
        """Centre, both ends of every axis and random surface points, (points, names)."""
        count = len(self.names)
        if not count:
            return np.zeros((1, 0))
        drawn = np.random.default_rng(seed).standard_normal((_DIRECTIONS * count, count))
        drawn /= np.linalg.norm(drawn, axis=1)[:, np.newaxis]
        return np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count), drawn])


def possible_joints(estimate: Estimate, confidence: float, sample_time: float) -> Interval:
    """Determine the joints that an estimate allows.

    Args:
        estimate: with deviations and correlations.
        confidence: of all its parameters together.
        sample_time: of the controller, seconds; springs are considered up to its Nyquist frequency.
    """
    if estimate.checks.bounds:
        return _springs(estimate, confidence, 0.5 / sample_time)
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
    return Interval(joint, values, tuple(p.name for p in chosen), factor, np.array(lower), (), description)


def ellipsoid_radius(parameters: int, confidence: float) -> float:
    """Radius of a confidence ellipsoid in standard deviations."""
    from scipy.special import gammaincinv

    return math.sqrt(2.0 * float(gammaincinv(parameters / 2.0, confidence))) if parameters else 0.0


def _springs(estimate: Estimate, confidence: float, last: float) -> Interval:
    """Joints with a refused stiffness, from its bounds upwards, at their load shares."""
    assert isinstance(estimate.settings.joint, FlexibleJoint) and estimate.checks.known is not None
    bounded = [bound for bound in estimate.checks.bounds if bound.frequency is not None]
    if not bounded:
        raise MethodError(
            f"The stiffness is refused and {estimate.data.record} does not bound it at any load share, "
            "so no margin can be "
            "stated; a record with pulses would, see jointid advise."
        )
    sums = {one.combination.quantity: one for one in estimate.checks.known.physical}
    inertia = sums.get("inertia")
    if inertia is None:
        raise MethodError(
            "The stiffness is refused and the total inertia not free, so it has no interval to state margins over."
        )
    radius = ellipsoid_radius(1, confidence)
    friction = {name: one.value for name, one in sums.items() if name != "inertia"}
    masses = [max(inertia.value + side * radius * inertia.std, _LEAST * inertia.value) for side in (-1, 1)]
    made: list[Mapping[str, float]] = []
    for mass in masses:
        for bound in bounded:
            assert bound.frequency is not None
            modes = np.geomspace(min(bound.frequency, last), last, _SPRINGS)
            made += [joint_with_mode(estimate.values, friction, mass, bound.share, float(mode)) for mode in modes]
    unbounded = [f"{bound.share:g}" for bound in estimate.checks.bounds if bound.frequency is None]
    listed = ", ".join(f"{number(bound.frequency, 3)} Hz at {bound.share:g}" for bound in bounded)
    description = (
        "the stiffness is refused: all springs no softer than its bounds, which are modes by the load's share of the "
        f"inertia ({listed}; 95 % each), damped by {100 * MODE_DAMPING:g} %, and the {100 * confidence:g} % "
        "interval of the total inertia"
    )
    if unbounded:
        description += f"; a share of {', '.join(unbounded)} is left out, as the record excludes no spring there"
    return Interval(estimate.settings.joint, made[0], (), np.zeros((0, 0)), np.zeros(0), tuple(made), description)


def find_worst_case(
    interval: Interval, law: SampledLaw, points: FloatArray, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Find the worst margins: at given points, along their slopes and nearby.

    Returns:
        The smallest of each margin, (5,), and the points of the unit ball with it, (found, names).
    """
    margins = interval.sample(points, law).margins(law)
    if not interval.names:
        return np.min(margins, axis=0), points[:1]
    rng = np.random.default_rng(seed)
    for _ in range(_ROUNDS):
        before = np.min(margins, axis=0)
        near = np.repeat(points[np.unique(np.argmin(margins, axis=0))], _NEAR, axis=0)
        near = near + _TURNED * rng.standard_normal(near.shape)
        near /= np.maximum(np.linalg.norm(near, axis=1), 1e-12)[:, np.newaxis]
        more = np.concatenate([_find_downhill_points(points, margins), near])
        margins = np.concatenate([margins, joint_set(interval.joint, interval.at(more), law).margins(law)])
        points = np.concatenate([points, more])
        after = np.min(margins, axis=0)
        if np.all(after >= before * (1 - 1e-3)) or not after[-1]:
            break
    return np.min(margins, axis=0), points[np.unique(np.argmin(margins, axis=0))]


def _find_downhill_points(points: FloatArray, margins: FloatArray) -> FloatArray:
    """For every margin, the surface point at which its linear part is smallest."""
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


def joint_with_mode(
    known: Mapping[str, float], friction: Mapping[str, float], inertia: float, share: float, mode: float
) -> dict[str, float]:
    """A flexible joint with a lightly damped mode and the friction on the motor's side.

    Args:
        known: shared and fixed parameters of flexible and rigid joint, by name.
        friction: total, in the names of a rigid joint.
        inertia: total.
        share: of the load.
        mode: Hz, free-free.
    """
    found = dict(known) | {f"motor_{name}": value for name, value in friction.items()}
    found |= {f"load_{name}": 0.0 for name in friction}
    return found | split_by_mode(inertia, share, mode)


def lowest_mode(modes: Sequence[float], kept: Sequence[bool]) -> float | None:
    """Lowest mode from which on all keep the margins; None if the last does not."""
    for mode, good in zip(reversed(modes), reversed(kept), strict=True):
        if not good:
            break
        lowest = mode
    return lowest if kept[-1] else None
