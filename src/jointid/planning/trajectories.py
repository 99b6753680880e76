"""A motion as the controllers of robots play it, a ROS 2 JointTrajectory.

Between two points controllers interpolate by a cubic of positions and velocities (ROS 2 control). As many samples are
left out as that keeps within `_EXACT` of the travel.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from jointid.common.arrays import FloatArray

_EXACT = 1e-4  # of the travel, that a cubic between the points is off at most
_SPARSEST = 0.02  # s between points, at most


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Points of a motion of n joints, positions in rad or m.

    Attributes:
        names: of the joints.
        time: (points,) s, from 0.
        positions, velocities, accelerations: (points, n).
    """

    names: tuple[str, ...]
    time: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    @classmethod
    def of(cls, names: Sequence[str], positions: FloatArray, sample_time: float) -> Self:
        """Return the sparsest points that keep a motion.

        Args:
            names: of the joints.
            positions: (samples, n) rad or m.
            sample_time: s.
        """
        from scipy.interpolate import CubicHermiteSpline

        time = sample_time * np.arange(len(positions))
        v = np.gradient(positions, sample_time, axis=0)
        a = np.gradient(v, sample_time, axis=0)
        allowed = _EXACT * np.maximum(np.ptp(positions, axis=0), 1e-9)
        for every in range(max(int(_SPARSEST / sample_time), 1), 0, -1):
            kept = np.unique([*range(0, len(time), every), len(time) - 1])
            between = CubicHermiteSpline(time[kept], positions[kept], v[kept])(time)
            if np.all(np.abs(between - positions).max(axis=0) <= allowed):
                break
        return cls(tuple(names), time[kept], positions[kept], v[kept], a[kept])

    def to_yaml(self) -> str:
        """Return a trajectory_msgs/JointTrajectory as YAML, as `ros2 topic pub` takes it."""
        lines = [f"joint_names: {json.dumps(self.names)}", "points:"]
        rows = zip(self.time, self.positions, self.velocities, self.accelerations, strict=True)
        for at, *row in rows:
            seconds, nanoseconds = divmod(round(1e9 * float(at)), 10**9)
            listed = (", ".join(f"{float(value):.9g}" for value in values) for values in row)
            names = ("- positions", "  velocities", "  accelerations")
            lines += [f"{name}: [{values}]" for name, values in zip(names, listed, strict=True)]
            lines.append(f"  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}")
        return "\n".join(lines) + "\n"
