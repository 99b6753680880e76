"""Worst-case margins: many joints under one law, and the joints of an ellipsoid at which they are smallest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import SampledLaw
from jointid.models.joints import Joint
from jointid.models.linear import ComplexArray, linear_joints
from jointid.tuning.interval import Interval
from jointid.tuning.loop import loop_response, spectral_radius
from jointid.tuning.margins import NAMES, all_margins, grid
from jointid.tuning.plant import SampledJoints, sample_joints

_ROUNDS = 4  # of looking for a worse joint
_NEAR = 6  # joints looked at around the worst one, for every margin
_TURNED = 0.3  # how far these are from it, in the unit ball
_STABLE = 1.0 - 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class JointSet:
    """Joints sampled for all laws of one period and delay.

    Attributes:
        hertz: (frequencies,). sampled: the joints. position: (joints, frequencies) their responses.
        ways: joints of each candidate: two where friction differs with the direction.
    """

    hertz: FloatArray
    sampled: SampledJoints
    position: ComplexArray
    ways: int

    @property
    def first(self) -> JointSet:
        """The first candidate alone."""
        s, kept = self.sampled, slice(0, self.ways)
        alone = replace(s, drive=s.drive.of(kept))
        return JointSet(self.hertz, alone, self.position[kept], self.ways)

    def response(self, law: SampledLaw) -> ComplexArray:
        """Return the loops cut open, (joints, frequencies)."""
        return loop_response(law, self.position, self.hertz)

    def margins(self, law: SampledLaw) -> FloatArray:
        """Return the margins of every candidate, (candidates, 5); 0 where its loop is not stable."""
        found = all_margins(self.response(law), self.hertz)
        found[spectral_radius(law, self.sampled) >= _STABLE] = 0.0
        return np.asarray(np.min(found.reshape(-1, self.ways, len(NAMES)), axis=1))


def joint_set(joint: Joint, candidates: Sequence[Mapping[str, float]], law: SampledLaw) -> JointSet:
    """Sample joints for a law, and others of its period and delay."""
    linear = linear_joints(joint, candidates)
    sampled = sample_joints(linear, law)
    hertz = grid(linear, law.period)
    return JointSet(hertz, sampled, sampled.response(hertz), len(linear.A) // len(candidates))


@dataclass(frozen=True, slots=True, eq=False)
class WorstCase:
    """The worst margins over an interval.

    Attributes:
        margins: (5,) each the smallest over all joints that were looked at.
        points: (found, names) of the unit ball, of the joints that are worst in one of them.
    """

    margins: FloatArray
    points: FloatArray


def find_worst_case(interval: Interval, law: SampledLaw, points: FloatArray, seed: int = 0) -> WorstCase:
    """Return the worst margins over an interval: over given points, then down their slopes and around the worst.

    Args:
        interval: of the joints.
        law: of the controller.
        points: (points, names) of the unit ball, to begin with.
        seed: of the joints that are tried around the worst.
    """
    joints = [*interval.at(points), *interval.others]
    margins = joint_set(interval.joint, joints, law).margins(law)
    if not interval.names:
        return WorstCase(np.min(margins, axis=0), points[:1])
    rng = np.random.default_rng(seed)
    for _ in range(_ROUNDS):
        before = np.min(margins, axis=0)
        more = np.concatenate([_downhill(points, margins), _around(points, margins, rng)])
        margins = np.concatenate([margins, joint_set(interval.joint, interval.at(more), law).margins(law)])
        points = np.concatenate([points, more])
        after = np.min(margins, axis=0)
        if np.all(after >= before * (1 - 1e-3)) or not after[-1]:
            break
    return WorstCase(np.min(margins, axis=0), points[np.unique(np.argmin(margins, axis=0))])


def _downhill(points: FloatArray, margins: FloatArray) -> FloatArray:
    """Return, for every margin, where on the surface its straight part is smallest."""
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


def _around(points: FloatArray, margins: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return joints around the worst ones, on the surface."""
    worst_ones = points[np.unique(np.argmin(margins, axis=0))]
    drawn = np.repeat(worst_ones, _NEAR, axis=0)
    drawn = drawn + _TURNED * rng.standard_normal(drawn.shape)
    return np.asarray(drawn / np.maximum(np.linalg.norm(drawn, axis=1), 1e-12)[:, np.newaxis])
