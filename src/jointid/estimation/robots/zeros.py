"""Search for encoder zeros that are not the model's.

With the encoder's zero at the angle ``z`` of the model, link `j` of the model is turned by ``z`` about its joint axis.
For fixed zeros the inverse model is linear in all other parameters, so a zero is searched by its effect on the least
residual (variable projection, Golub and Pereyra 1973): over a grid of angles, then by descent.

Not every zero acts on the residual. That of a first joint whose axis is vertical, or of the last joint, only turns the
frame that the inertial parameters of its link are given in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.robots.regression import RobotMotion, base_columns, base_rows, join_rows, motion_of_robot
from jointid.models.robots.base_parameters import base_parameters
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.covariance import sandwich

_GRID = tuple(np.arange(-5, 7) * np.pi / 6)  # rad
_GAIN = 0.8  # a zero is found where it lowers the residual, rms over the joints, to less than this share
_INSTANTS = 600  # of the grid's rows
_WIDTH = 0.3  # rad, about how far the grid is from a minimum
_EVALUATIONS = 30
_RANK = 1e-12  # of the normal matrix, whose columns have length 1
_TOLERANCE, _STEP = 1e-6, 1e-4  # rad


@dataclass(frozen=True, slots=True)
class EncoderZero:
    """An encoder zero that lowers the residual.

    Attributes:
        joint: its name.
        zero: position of the model's joint where the encoder reads 0, rad.
        stderr: standard error of the zero, rad.
        residual, residual_without: rms over the joints of the unexplained share of their torques.
    """

    joint: str
    zero: float
    stderr: float
    residual: float
    residual_without: float

    def __str__(self) -> str:
        return (
            f"the torques fit an encoder of {self.joint} that reads 0 where the joint of the model is at "
            f"{self.zero:.4g} ± {2.0 * self.stderr:.2g} rad: the model then leaves {100 * self.residual:.3g} instead "
            f"of {100 * self.residual_without:.3g} % of the torques"
        )


def find_zeros(robot: Robot, logs: Sequence[Sequence[Record]], filtering: Filtering) -> tuple[EncoderZero, ...]:
    """Find revolute joints whose encoder zero is not the model's.

    Joints are searched one after the other; each that clearly lowers the residual is kept for the search of the next.

    Args:
        robot: the model, with the zeros declared.
        logs: the records of each joint, with torque and motor position, for each log.
        filtering: of positions and rows.

    Returns:
        One for each joint found, in the order of their effect; empty if there is none.

    Raises:
        RecordError: a channel is missing, or the joints' records have not one clock.
        MethodError: a torque is 0 throughout.

    Limits: joints that are rigid in the band of the filter; at least two joints that move.
    """
    motions = [motion_of_robot(robot, log, filtering) for log in logs]
    coarse = [_thin(motion) for motion in motions]
    left = [j for j, link in enumerate(robot.links) if link.kind == "revolute"]
    zeros, found = np.zeros(len(robot)), list[int]()
    first = before = _residual(robot, motions)
    while left:
        ends = [(j, _search(robot, zeros, [*found, j], motions, coarse)) for j in left]
        j, tried = min(ends, key=lambda one: _residual(robot.turn(one[1]), motions))
        after = _residual(robot.turn(tried), motions)
        if not after < _GAIN * before:
            break
        zeros, before = tried, after
        found.append(j)
        left.remove(j)
    errors = _standard_errors(robot, zeros, found, motions)
    return tuple(
        EncoderZero(robot.names[j], float(zeros[j]), float(error), before, first)
        for j, error in zip(found, errors, strict=True)
    )


def _search(
    robot: Robot,
    known: FloatArray,
    joints: Sequence[int],
    motions: Sequence[RobotMotion],
    coarse: Sequence[RobotMotion],
) -> FloatArray:
    """Return the zeros, (n,), of least residual, of which those of some joints are free, the last from a grid."""
    from scipy.optimize import least_squares

    starts = [known + angle * np.eye(len(robot))[joints[-1]] for angle in _GRID]
    start = min(starts, key=lambda one: _rms(_fit_samples(robot.turn(one), coarse)))

    def place(free: FloatArray) -> FloatArray:
        zeros: FloatArray = start.copy()
        zeros[list(joints)] = free
        return zeros

    def error(free: FloatArray) -> FloatArray:
        return _fit(robot.turn(place(free)), motions).error

    end = least_squares(
        error,
        start[list(joints)],
        diff_step=np.full(len(joints), _STEP),
        x_scale=_WIDTH,
        xtol=_TOLERANCE,
        max_nfev=_EVALUATIONS,
    )
    return place(np.asarray(end.x))


class _Fit(NamedTuple):
    """The parameters of least residual: columns and error in rows of which each joint's torque has the norm 1."""

    columns: FloatArray
    values: FloatArray
    error: FloatArray


def _fit(robot: Robot, motions: Sequence[RobotMotion]) -> _Fit:
    """Return the fit of all base parameters and friction to filtered rows."""
    base, n = base_parameters(robot), len(robot)
    each = [base_rows(robot, base, motion) for motion in motions]
    return _solve(join_rows([one.W for one in each], n), join_rows([one.Y for one in each], n), n)


def _fit_samples(robot: Robot, motions: Sequence[RobotMotion]) -> _Fit:
    """Return the fit to samples as they are: faster, and close enough for a grid."""
    base, n = base_parameters(robot), len(robot)
    W = np.concatenate(
        [base_columns(robot, base, one.q, one.v, one.a) * one.moving[:, :, np.newaxis] for one in motions]
    )
    Y = np.concatenate([one.torque * one.moving for one in motions])
    return _solve(W.transpose(1, 0, 2).reshape(-1, W.shape[2]), Y.T.ravel(), n)


def _thin(motion: RobotMotion) -> RobotMotion:
    """Return every few samples of a motion."""
    step = max(len(motion.q) // _INSTANTS, 1)
    parts = {name: getattr(motion, name)[motion.inside][::step] for name in ("q", "v", "a", "torque", "moving")}
    return replace(motion, **parts)


def _solve(W: FloatArray, Y: FloatArray, n: int) -> _Fit:
    sizes = np.repeat(np.linalg.norm(Y.reshape(n, -1), axis=1), Y.size // n)
    W, Y = W / sizes[:, np.newaxis], Y / sizes
    norms = np.maximum(np.linalg.norm(W, axis=0), np.finfo(float).tiny)
    A = W / norms
    values = np.linalg.pinv(A.T @ A, rcond=_RANK, hermitian=True) @ (A.T @ Y)
    return _Fit(W, values / norms, Y - A @ values)


def _rms(fit: _Fit) -> float:
    return float(np.linalg.norm(fit.error))


def _residual(robot: Robot, motions: Sequence[RobotMotion]) -> float:
    """Return the rms over the joints of the least unexplained share of their torques."""
    return _rms(_fit(robot, motions)) / math.sqrt(len(robot))


def _standard_errors(
    robot: Robot, zeros: FloatArray, joints: Sequence[int], motions: Sequence[RobotMotion]
) -> FloatArray:
    """Return the standard errors of some zeros beside all other parameters, robust to autocorrelation."""
    if not joints:
        return np.zeros(0)
    fit, slopes = _fit(robot.turn(zeros), motions), []
    for step in _STEP * np.eye(len(robot))[list(joints)]:
        ahead, behind = (_fit(robot.turn(zeros + way * step), motions).columns for way in (1, -1))
        slopes.append((ahead - behind) @ fit.values / (2 * _STEP))
    J = np.column_stack([fit.columns, *slopes])
    return sandwich(J, J, fit.error, len(robot)).std[-len(joints) :]
