"""Fourier-series motions from rest to rest within position and speed limits.

J. Swevers, C. Ganseman, D. B. Tükel, J. De Schutter and H. Van Brussel (Optimal robot excitation and identification,
IEEE Transactions on Robotics and Automation 13, 1997) move every joint along::

    q(t) = c + s sum_h a_h sin(h w t) + b_h cos(h w t),      w = 2 pi / T

The motion is periodic and differentiable exactly. Here velocity and acceleration are also 0 at the first instant,
``sum h a_h = sum h^2 b_h = 0``. The search varies the remaining freedom of a and b, the share of the limits and the
position between them: s is the largest that keeps the limits, times that share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.models.limits import AxisLimits

_INSIDE = 0.98  # of speed and acceleration: a motor passes where its reference turns round
_MARGIN = 0.01  # of the room, at each end, likewise
_LEAST = 0.3  # of what the limits let it, that a joint moves at least
_POINTS = 32  # of a period, for each harmonic, at which limits are held


Bases: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Of positions, velocities and accelerations."""


@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """The parametrised Fourier series of n joints.

    Attributes:
        limits: of each joint; positions and speed must be given.
        period: T of the module, s.
        harmonics: of it.
        share: of speed and acceleration that they may use; below 1 something is added, which has a margin of its own.
    """

    limits: tuple[AxisLimits, ...]
    period: float
    harmonics: int
    share: float = 1.0

    @property
    def size(self) -> int:
        """Number of search variables: coefficients, share and position of each joint."""
        return len(self.limits) * (2 * self.harmonics)

    def bases(self, time: FloatArray) -> Bases:
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

    def play(self, numbers: FloatArray, time: FloatArray) -> Bases:
        """Return positions, velocities and accelerations of all joints, (instants, n) each.

        Args:
            numbers: (size,) of the motion, between 0 and 1.
            time: (instants,) s.
        """
        count = _POINTS * self.harmonics
        seen, whole = self.bases(time), self.bases(np.linspace(0.0, self.period, count, endpoint=False))
        found = [np.empty((len(time), len(self.limits))) for _ in range(3)]
        rows = numbers.reshape(len(self.limits), -1)
        for k, (limit, row) in enumerate(zip(self.limits, rows, strict=True)):
            weights, (share, place) = 2.0 * row[:-2] - 1.0, row[-2:]
            q, v, a = (basis @ weights for basis in whole)
            assert limit.lower is not None and limit.upper is not None
            margin = (_MARGIN if self.share == 1.0 else 2.0 * _MARGIN) * (limit.upper - limit.lower)
            room = limit.upper - limit.lower - 2.0 * margin
            jerk = np.diff(a) * count / self.period
            sizes = ((limit.speed, v), (limit.acceleration, a), (limit.jerk, jerk))
            scales = [self.share * _INSIDE * most / np.max(np.abs(one)) for most, one in sizes if most is not None]
            strokes = (room, math.inf if limit.stroke is None else limit.stroke - 2.0 * margin)
            scale = min(*scales, min(strokes) / np.ptp(q)) * (_LEAST + (1.0 - _LEAST) * share)
            spare = room - scale * np.ptp(q)
            centre = limit.lower + margin + spare * place - scale * q.min()
            for out, basis, shift in zip(found, seen, (centre, 0.0, 0.0), strict=True):
                out[:, k] = shift + scale * (basis @ weights)
        return found[0], found[1], found[2]


def complete(limits: Sequence[AxisLimits], motion: Bases | None, names: Sequence[str]) -> tuple[AxisLimits, ...]:
    """Complete limits from a record.

    Args:
        limits: of each joint.
        motion: positions, velocities and accelerations of the record, (samples, n) each; None without one.
        names: of the joints.

    Raises:
        MethodError: a limit is neither given nor in the record.
    """
    found, missing = [], list[str]()
    for k, one in enumerate(limits):
        seen: dict[str, float] = {}
        if motion is not None:
            q, v = motion[0][:, k], motion[1][:, k]
            seen = {"lower": float(q.min()), "upper": float(q.max()), "speed": float(np.abs(v).max())}
        found.append(replace(one, **{name: size for name, size in seen.items() if getattr(one, name) is None}))
        if lacking := [name for name in ("lower", "upper", "speed") if getattr(found[-1], name) is None]:
            missing.append(f"{names[k]} ({', '.join(lacking)})")
    if missing:
        raise MethodError(
            f"A motion is planned within limits of position and speed, and some are missing: {'; '.join(missing)}. "
            "Give them as limits = { lower = ..., upper = ..., speed = ... } of each of the [[joints]], or a first "
            "record."
        )
    return tuple(found)
