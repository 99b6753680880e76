"""Open-loop response, stability and margins of a sampled law over an interval.

The loop is cut at the torque: ``L(z) = -F(z) P(z)``, F the law's response to the motor position and P the joint's,
sampled exactly under a held and delayed torque (`models.linear.SampledDrive`). Limits and gravity that turns with the
link, a weak spring, are ignored. For a multirate law, L is the component at the frequency itself, without images; its
stability is exact over a whole cycle.

All crossings count, since a lightly damped mode crosses several times. The response is interpolated linearly on a grid
that is dense near modes (`grid`): within 0.3 % of python-control's result on polynomials.
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
from jointid.models.controllers import POSITION, SampledLaw
from jointid.models.joints import Joint
from jointid.models.linear import ComplexArray, LinearJoints, SampledDrive, discretise, linear_joints, sampled_position

_LOWEST = 1e-4  # of half the sampling frequency, where a grid begins
_BASE = 1000  # frequencies without modes
_PER_WIDTH = 15  # frequencies in the half width of a resonance
_NARROWEST = 5e-4  # damping ratio below which the grid is not refined
_MOST = 2500  # frequencies for the modes
_WIDTHS = 8  # of a resonance, on each side of the modes
_STABLE = 1.0 - 1e-12
_MOVES = (Quantity.INERTIA, Quantity.VISCOUS, Quantity.STIFFNESS)
_LEAST = 1e-3  # of an inertia or a stiffness: what an interval reaches at least, since without it there is no mode
_DIRECTIONS = 300  # random ones

NAMES = ("gain", "reduction", "phase", "delay", "modulus")  # of the margins, in the order of the arrays


@dataclass(frozen=True, slots=True)
class Margins:
    """Margins of a loop; 0 if unstable, infinite without a crossing.

    Attributes:
        gain: admissible increase of the loop's gain, a ratio. reduction: admissible decrease, a ratio above 1.
        phase: admissible change of phase either way, rad.
        delay: admissible additional delay of the loop, seconds.
        modulus: the smallest distance of the response from -1, the inverse of the largest sensitivity.
    """

    gain: float
    reduction: float
    phase: float
    delay: float
    modulus: float

    @property
    def stable(self) -> bool:
        """True if the loop is stable."""
        return self.modulus > 0.0


@dataclass(frozen=True, slots=True, eq=False)
class JointSet:
    """Joints sampled for all laws of one period and delay.

    Attributes:
        hertz: (frequencies,). drive: of all joints. position: (joints, frequencies) their responses.
        ways: joints of each candidate: two where friction differs with the direction.
    """

    hertz: FloatArray
    drive: SampledDrive
    position: ComplexArray
    ways: int

    @property
    def first(self) -> JointSet:
        """The first candidate alone."""
        return JointSet(self.hertz, self.drive.of(slice(self.ways)), self.position[: self.ways], self.ways)

    def response(self, law: SampledLaw) -> ComplexArray:
        """Return the loops cut open, (joints, frequencies)."""
        feedback, _ = law.split()
        return np.asarray(-feedback.feedback(self.hertz) * self.position)

    def margins(self, law: SampledLaw) -> FloatArray:
        """Margins of every candidate, (candidates, 5); 0 if unstable."""
        found = all_margins(self.response(law), self.hertz)
        found[spectral_radius(law, self.drive) >= _STABLE] = 0.0
        return np.asarray(np.min(found.reshape(-1, self.ways, len(NAMES)), axis=1))


def joint_set(joint: Joint, candidates: Sequence[Mapping[str, float]], law: SampledLaw) -> JointSet:
    """Sample joints for a law, and others of its period and delay."""
    linear = linear_joints(joint, candidates)
    drive = discretise(linear.A, linear.B, law.period, law.delay)
    hertz = grid(linear, law.period)
    turned = np.asarray(2j * math.pi * hertz * law.period)
    position = np.asarray(sampled_position(drive, turned) * np.exp(-drive.whole * turned))
    return JointSet(hertz, drive, position, len(linear.A) // len(candidates))


def grid(joints: LinearJoints, period: float) -> FloatArray:
    """Frequency grid for some joints, Hz, up to Nyquist."""
    last = 0.5 / period
    parts = [np.geomspace(_LOWEST * last, last, _BASE)]
    for kind in range(joints.modes.shape[1]):
        at, ratio = joints.modes[:, kind, 0], np.maximum(joints.modes[:, kind, 1], _NARROWEST)
        narrow = float(np.min(ratio))
        width = _WIDTHS * min(narrow, 0.05)
        low, high = float(np.min(at)) * (1 - width), min(float(np.max(at)) * (1 + width), last)
        if low < high:
            steps = math.log(high / low) * _PER_WIDTH / min(narrow, 0.05)
            parts.append(np.geomspace(low, high, min(max(round(steps), 2), _MOST)))
    return np.unique(np.concatenate(parts))


def all_margins(response: ComplexArray, hertz: FloatArray) -> FloatArray:
    """Margins of stable loops, (loops, 5), in the order of `NAMES`.

    Args:
        response: open-loop, (loops, frequencies).
        hertz: (frequencies,) rising, the last at Nyquist, where a response is real.
    """
    before, after = response[:, :-1], response[:, 1:]
    grow, fall, turn, late = (np.full(len(response), np.inf) for _ in range(4))
    # Where the imaginary part changes its sign the response crosses the real axis, and at Nyquist it is on it.
    loop, at = np.nonzero(np.signbit(before.imag) != np.signbit(after.imag))
    first, then = before[loop, at], after[loop, at]
    size = -(first.real + first.imag / (first.imag - then.imag) * (then.real - first.real))
    loop, size = np.concatenate([loop, np.arange(len(before))]), np.concatenate([size, -response[:, -1].real])
    inside, outside = (size > 0) & (size < 1), size >= 1
    np.minimum.at(grow, loop[inside], 1 / size[inside])
    np.minimum.at(fall, loop[outside], size[outside])
    loop, at = np.nonzero((_square(before) < 1.0) != (_square(after) < 1.0))
    first, then = before[loop, at], after[loop, at]
    sizes = np.log(np.abs(first)), np.log(np.abs(then))
    share = sizes[0] / (sizes[0] - sizes[1])
    lead = np.angle(-first * np.exp(1j * share * np.angle(then / first)))
    rate = 2 * math.pi * (hertz[at] + share * (hertz[at + 1] - hertz[at]))
    np.minimum.at(turn, loop, np.abs(lead))
    np.minimum.at(late, loop, np.mod(lead, 2 * math.pi) / rate)
    step = after - before
    along = np.clip(-((before + 1) * step.conj()).real / np.maximum(_square(step), 1e-300), 0.0, 1.0)
    modulus = np.sqrt(np.min(_square(before + along * step + 1), axis=1))
    return np.column_stack([grow, fall, turn, late, modulus])


def _square(response: ComplexArray) -> FloatArray:
    return np.asarray(response.real**2 + response.imag**2)


def crossover(response: ComplexArray, hertz: FloatArray) -> float:
    """Highest frequency, Hz, of unit gain over all loops; 0 if none."""
    above = np.any(np.abs(response) >= 1.0, axis=0)
    return float(hertz[np.flatnonzero(above)[-1]]) if above.any() else 0.0


def spectral_radius(law: SampledLaw, drive: SampledDrive) -> FloatArray:
    """Largest closed-loop eigenvalue over a cycle, (joints,); stable below 1."""
    feedback, _ = law.split()
    # States that affect the torque: an unused integral may grow.
    reaching = np.any(feedback.C[:, feedback.output] != 0.0, axis=0)
    edges = np.any(feedback.A != 0.0, axis=0)  # (to, from)
    while not np.array_equal(more := reaching | (reaching @ edges), reaching):
        reaching = more
    order, states, waiting = int(np.sum(reaching)), drive.transition.shape[1], drive.waiting
    size = states + order + waiting
    cycle = np.broadcast_to(np.eye(size), (len(drive.transition), size, size))
    for phase in range(law.phases):
        A, B = feedback.A[phase][np.ix_(reaching, reaching)], feedback.B[phase, reaching, POSITION]
        C, D = feedback.C[phase, law.output, reaching], feedback.D[phase, law.output, POSITION]
        step = np.zeros((len(drive.transition), size, size))
        torque = np.zeros(size)  # of the period, from all states
        torque[0], torque[states : states + order] = D, C
        step[:, :states, :states] = drive.transition
        for late, into in ((drive.whole, drive.new), (drive.whole + 1, drive.old)):
            if late == 0:
                step[:, :states] += into[..., np.newaxis] * torque
            elif late <= waiting:
                step[:, :states, states + order + late - 1] += into
        step[:, states : states + order, 0], step[:, states : states + order, states : states + order] = B, A
        if waiting:
            step[:, states + order] = torque
            for i in range(1, waiting):
                step[:, states + order + i, states + order + i - 1] = 1.0
        cycle = step @ cycle
    return np.asarray(np.max(np.abs(np.linalg.eigvals(cycle)), axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Possible joints of an estimate.

    If every parameter is significant, these are the joints of the confidence ellipsoid of the parameters that move the
    loop (inertias, viscous frictions, spring and damper)::

        (x - x0)' C^-1 (x - x0) <= q,    q the quantile of chi-square with as many degrees of freedom as parameters

    It holds all parameters together, so any number of margins hold together with at least this confidence, also for
    loops designed from the same record.

    Attributes:
        joint, nominal: of the estimate, and its parameters by name.
        names: of the parameters that span the ellipsoid, factor: (names, names) from a unit ball to it, lower: bounds.
        description: the interval in a sentence.
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

    def sample(self, seed: int, law: SampledLaw) -> JointSet:
        """Sample the estimate, the ends of every axis and random surface points."""
        count = len(self.names)
        drawn = np.random.default_rng(seed).standard_normal((_DIRECTIONS if count else 0, count))
        drawn /= np.linalg.norm(drawn, axis=1)[:, np.newaxis]
        points = np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count), drawn])
        return joint_set(self.joint, self.at(points), law)


def possible_joints(estimate: Estimate, confidence: float) -> Interval:
    """Joints within an estimate's confidence ellipsoid of all parameters together.

    Raises:
        MethodError: the estimate has no deviations or no correlations.
    """
    from scipy.special import gammaincinv

    joint, values = estimate.settings.joint, estimate.require_values()
    free = [p.name for p in estimate.rows if p.free]
    moving = {p.name: p for p in joint.parameters if p.quantity in _MOVES}
    chosen = [p for p in estimate.rows if p.name in moving and p.free]
    at = [free.index(p.name) for p in chosen]
    if any(p.deviation is None for p in chosen) or max(at, default=-1) >= len(estimate.correlation):
        raise MethodError(
            "Margins over an interval need the deviations of the parameters and their correlation, and this estimate "
            f"of {estimate.data.record} has none; identify by least squares."
        )
    std = np.array([p.deviation for p in chosen], dtype=np.float64)
    radius = math.sqrt(2.0 * float(gammaincinv(len(chosen) / 2.0, confidence))) if chosen else 0.0
    size, axes = np.linalg.eigh(estimate.correlation[np.ix_(at, at)])
    factor = radius * std[:, np.newaxis] * axes * np.sqrt(np.maximum(size, 0.0))
    lower = [
        max(moving[p.name].lower, 0.0) if moving[p.name].quantity is Quantity.VISCOUS else _LEAST * values[p.name]
        for p in chosen
    ]
    symbols, deviations = ", ".join(p.symbol for p in chosen), f"{number(radius, 3)} standard deviations"
    description = f"the {100 * confidence:g} % confidence ellipsoid of {symbols} together: {deviations} every way"
    return Interval(joint, values, tuple(p.name for p in chosen), factor, np.array(lower), description)
