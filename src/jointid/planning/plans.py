"""Test families: a joint's motion with added torque, or robot Fourier series.

A test is a family and numbers between 0 and 1. Drives generate trapezoids (with a jerk limit) and sums of sines; test
benches play tables. A joint's family combines one such motion with one added signal.

J. Swevers, C. Ganseman, D. B. Tükel, J. De Schutter and H. Van Brussel (Optimal robot excitation and identification,
IEEE Transactions on Robotics and Automation 13, 1997) move every joint of a robot along::

    q(t) = c + s sum_h a_h sin(h w t) + b_h cos(h w t),      w = 2 pi / T

The motion is periodic and differentiable exactly. Here velocity and acceleration are also 0 at the first instant,
``sum h a_h = sum h^2 b_h = 0``. The search varies the remaining freedom of a and b, the share of the limits and the
position between them: s is the largest that keeps the limits, times that share.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.limits import AxisLimits
from jointid.simulation import excitation

_SPEEDS = 3  # of the trapezoids of one cycle
_REST = 0.4  # s before each way at most
_INSIDE = 0.985  # of the stroke, that a reference takes at most: the motor passes where it was asked to stop
_LINES = 24  # of a sum of sines

_SHARE = 0.98  # of speed and acceleration of a series: a motor passes where its reference turns round
_MARGIN = 0.01  # of the room, at each end, likewise
_LEAST = 0.3  # of what the limits let it, that a joint moves at least
_POINTS = 32  # of a period, for each harmonic, at which limits are held

Numbers: TypeAlias = Sequence[float]


Signal: TypeAlias = Callable[[Numbers, "Family", int, float], FloatArray]
"""Values, (samples,), from numbers between 0 and 1, a family with its ranges, a count of samples and their time."""


def _log(low: float, high: float, share: float) -> float:
    return low * math.pow(high / low, share)


def _trapezoids(u: Numbers, of: Family, samples: int, sample_time: float) -> FloatArray:
    room, jerk = of.room.stated, of.room.jerk
    speeds = tuple(_log(0.05, 1.0, one) * room["speed"] for one in u[:_SPEEDS])
    acceleration = _log(0.05, 1.0, u[_SPEEDS]) * room["acceleration"]
    travel, rest = _log(0.05, _INSIDE, u[_SPEEDS + 1]) * room["stroke"], _REST * u[_SPEEDS + 2]
    smoothing = 0.0 if jerk is None else 2 * acceleration / jerk  # from full ahead to full back
    lasts = samples * sample_time
    played = excitation.trapezoids(speeds, acceleration, travel, sample_time, rest=rest, duration=lasts)[:samples]
    # A way that would exceed the time is left out: the axis rests at the last reversal.
    ends = np.flatnonzero(np.minimum(played, travel - played) <= acceleration * sample_time**2)
    ends = ends[ends < samples - round(smoothing / sample_time)]
    last = int(ends[-1]) if ends.size else 0
    kept = np.append(played[: last + 1], np.full(samples - 1 - last, played[last]))
    return room["lower"] + 0.5 * (room["stroke"] - travel) + excitation.smooth(kept, sample_time, smoothing)


def _sines(u: Numbers, of: Family, samples: int, sample_time: float) -> FloatArray:
    """Sum position sines with equal accelerations."""
    stroke, least = of.room.stated["stroke"], of.room.lowest
    lowest = _log(least, max(0.3 * of.highest, least), u[1])
    highest = min(max(_log(least, of.highest, u[2]), 1.05 * lowest), of.highest)
    amplitude = 0.5 * _log(0.02, _INSIDE, u[0]) * stroke
    wave = excitation.multisine(samples, sample_time, amplitude, lowest, highest, lines=_LINES, tilt=2.0)
    return of.room.stated["lower"] + 0.5 * stroke + wave


def _torque_sines(u: Numbers, of: Family, samples: int, sample_time: float) -> FloatArray:
    least = max(of.room.lowest, 0.05 * of.mode)
    lowest = _log(least, max(0.9 * of.highest, least), u[1])
    highest = min(lowest * _log(1.02, 10.0, u[2]), of.highest)
    amplitude = _log(0.02, 1.0, u[0]) * of.room.stated["torque"]
    return excitation.multisine(samples, sample_time, amplitude, lowest, highest, lines=_LINES)


def _torque_lines(u: Numbers, of: Family, samples: int, sample_time: float) -> FloatArray:
    size, tilt = _log(0.02, 0.7, u[0]) * of.room.stated["torque"], 2.0 * u[1]
    frequencies, shares = zip(*of.lines, strict=True)
    # Friction wants more at low frequencies than a joint without it, or less: the shares may be levelled.
    return excitation.sines(samples, sample_time, frequencies, [size * share**tilt for share in shares])


_MOTIONS: Mapping[str, tuple[int, Signal]] = {"trapezoids": (_SPEEDS + 3, _trapezoids), "sines": (3, _sines)}
_ADDED: Mapping[str, tuple[int, Signal | None]] = {
    "nothing": (0, None), "sines": (3, _torque_sines), "lines": (2, _torque_lines),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Family:
    """Tests of a joint.

    Attributes:
        motion: "trapezoids" or "sines".
        added: to the torque: "nothing", "sines" or "lines".
        room: their ranges, all stated, the stroke from `lower` on; None only of a jerk that is not limited.
        highest: frequency of sines, Hz.
        mode: about where the joint's resonance is, Hz; of a rigid one half of the highest.
        lines: frequencies, Hz, of the most informative sines for a joint without friction, and their amplitudes, the
            largest 1; empty if unknown.
    """

    motion: str
    added: str
    room: AxisLimits
    highest: float
    mode: float
    lines: tuple[tuple[float, float], ...] = ()

    @property
    def words(self) -> tuple[str, str]:
        """Motion of the joint, and excitation added to the torque."""
        return self.motion, self.added

    @property
    def size(self) -> int:
        """Number of search variables of a test."""
        return _MOTIONS[self.motion][0] + _ADDED[self.added][0]

    def play(self, numbers: Numbers, time: FloatArray) -> tuple[FloatArray, ...]:
        """Reference of the test, and any signal added to its torque, (samples,)."""
        at = self, time.size, float(time[1] - time[0])
        count, motion = _MOTIONS[self.motion]
        added = _ADDED[self.added][1]
        return motion(numbers[:count], *at), *(() if added is None else (added(numbers[count:], *at),))


def families_in(
    room: AxisLimits, highest: float, mode: float, lines: tuple[tuple[float, float], ...], *, injection: bool = True
) -> tuple[Family, ...]:
    """Families to search; without `injection` only those that add no torque."""
    possible = [one for one in _ADDED if (injection or one == "nothing") and (one != "lines" or lines)]
    return tuple(Family(motion, one, room, highest, mode, lines) for motion in _MOTIONS for one in possible)


@dataclass(frozen=True, slots=True)
class Series:
    """Tests of a robot: the Fourier series of its n joints.

    Attributes:
        limits: of each joint; positions and speed must be given.
        period: T of the module, s.
        harmonics: of it.
        share: usable share of the limits of speed and acceleration; the rest is kept for added multisines.
    """

    limits: tuple[AxisLimits, ...]
    period: float
    harmonics: int
    share: float = 1.0

    @property
    def words(self) -> tuple[str, str]:
        """Motion of the joints, and the excitation of their modes."""
        return f"a Fourier series of {self.harmonics} harmonics of every joint", "multisines about the modes"

    @property
    def size(self) -> int:
        """Number of search variables: coefficients, share and position of each joint."""
        return len(self.limits) * (2 * self.harmonics)

    def _bases(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Basis of position, velocity and acceleration, (instants, 2 harmonics - 2)."""
        h = np.arange(1, self.harmonics + 1, dtype=np.float64)
        w = 2.0 * math.pi / self.period * h
        sines, cosines = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
        # Amplitudes that fall with the frequency: the same speed of all harmonics.
        null_spaces = (np.linalg.svd(row[np.newaxis])[2][1:].T for row in (np.ones(h.size), h))
        a, b = (space / h[:, np.newaxis] for space in null_spaces)
        return (
            np.hstack([sines @ a, cosines @ b]),
            np.hstack([cosines * w @ a, -sines * w @ b]),
            np.hstack([-sines * w**2 @ a, -cosines * w**2 @ b]),
        )

    def play(self, numbers: Numbers, time: FloatArray) -> tuple[FloatArray, ...]:
        """Return positions, velocities and accelerations of all joints, (instants, n) each.

        Args:
            numbers: (size,) of the motion, between 0 and 1.
            time: (instants,) s.
        """
        count = _POINTS * self.harmonics
        seen, whole = self._bases(time), self._bases(np.linspace(0.0, self.period, count, endpoint=False))
        found = [np.empty((len(time), len(self.limits))) for _ in range(3)]
        rows = np.array(numbers).reshape(len(self.limits), -1)
        for k, (limit, row) in enumerate(zip(self.limits, rows, strict=True)):
            weights, (share, place) = 2.0 * row[:-2] - 1.0, row[-2:]
            q, v, a = (basis @ weights for basis in whole)
            assert limit.lower is not None and limit.upper is not None
            margin = (_MARGIN if self.share == 1.0 else 2.0 * _MARGIN) * (limit.upper - limit.lower)
            room = limit.upper - limit.lower - 2.0 * margin
            jerk = np.diff(a) * count / self.period
            sizes = ((limit.speed, v), (limit.acceleration, a), (limit.jerk, jerk))
            scales = [self.share * _SHARE * most / np.max(np.abs(one)) for most, one in sizes if most is not None]
            strokes = (room, math.inf if limit.stroke is None else limit.stroke - 2.0 * margin)
            scale = min(*scales, min(strokes) / np.ptp(q)) * (_LEAST + (1.0 - _LEAST) * share)
            spare = room - scale * np.ptp(q)
            centre = limit.lower + margin + spare * place - scale * q.min()
            for out, basis, shift in zip(found, seen, (centre, 0.0, 0.0), strict=True):
                out[:, k] = shift + scale * (basis @ weights)
        return tuple(found)


@dataclass(frozen=True, slots=True)
class Plan:
    """A test of a family, scaled about its first position."""

    family: Family | Series
    numbers: tuple[float, ...]
    factor: float = 1.0

    def scale(self, factor: float) -> Plan:
        """Return the test with smaller signals."""
        return replace(self, factor=factor * self.factor)

    def play(self, time: FloatArray) -> tuple[FloatArray, ...]:
        """Signals of the test at instants from 0 on, the positions first."""
        position, *others = self.family.play(self.numbers, time)
        return position[0] + self.factor * (position - position[0]), *(self.factor * one for one in others)
