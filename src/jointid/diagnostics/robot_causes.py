"""Causes of a robot's misfit: base, gear, order, coupling, length.

Each is a change of the log or of the model, with which the inverse model is solved again on some hundred instants. Its
numbers are searched on a grid, then by descent (variable projection). Of the squares of all joints, each relative to
its error as declared, the cause that lowers the sum most is named, if it leaves little more than the noise. To add one,
yield its row in `_changes`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import join, number
from jointid.diagnostics.changes import Cause
from jointid.estimation.parameters import robot_parameters
from jointid.estimation.problems.inverse_model import measure_motion
from jointid.models.robots.base_parameters import inverse_columns
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, lowpass

_INSTANTS = 200
_RANK = 1e-12  # of the normal matrix, whose columns have length 1
_LEAVES = 0.4  # of the squares of all errors beyond their noise: what leaves more is not the cause
_BEYOND = 0.2  # of the squares of a joint's errors, which is more than chance adds to the noise of `_INSTANTS`
_SIMPLER = 1.25  # times: so much more may be left by a cause with one free number less
_BEST = 4  # causes whose numbers are searched, beside those of vectors, whose start is nothing or a rough direction
_STEPS = 8  # of a descent
_SAME = 1e-9  # of the travel
_REST = 0.02  # of the largest speed: below, Coulomb friction is left out
_ZEROS = tuple((np.pi / 6 * k,) for k in range(-5, 7) if k)  # rad
_GEARS = (0.1, 0.3, 0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 3.0, 10.0, math.pi / 180, 180 / math.pi, 1e-3, 1e3)  # units, too
_FACTORS = tuple((math.log(one),) for one in _GEARS)
_COUPLED = ((-1.0,), (-0.5,), (0.5,), (1.0,))
_GRAVITY = 9.81  # m/s2
_LONGEST = 1.0  # m: a longer correction of a length is none

_OF_JOINT = (
    ("torque_sign", 0, 1), ("log_gain", 0, 1), ("position_sign", 1, 0), ("joint_sign", 1, 1), ("gear_ratio", 1, -1),
    ("position_scale", 1, 0),
)  # fmt: skip
"""Of one joint: the code, and the powers of a factor on its position and its torque; of a sign it is -1."""

_SAID = {
    "swapped_channels": "the torques of {joint} and {other} are exchanged: exchange the columns",
    "swapped_positions": "the positions of {joint} and {other} are exchanged: exchange the columns",
    "order": "the log has the joints in another order: the columns of {all} are those of each other",
    "torque_sign": "the torque of {joint} has the wrong sign: reverse torque.sign in joints.channels",
    "log_gain": "the logged torque of {joint} is {value} times what moves it: check its unit",
    "position_sign": "the position of {joint} has the wrong sign: reverse motor_position.sign in joints.channels",
    "joint_sign": "position and torque of {joint} have the wrong sign: reverse both in joints.channels",
    "gear_ratio": "the gear of {joint} has {value} times the declared ratio: position and torque are off by it",
    "position_scale": "the position of {joint} is {value} times what moves the links: check its unit and its ratio",
    "zero": "the encoder of {joint} reads 0 where its model is near {value} rad: check it, and give its zero",
    "geometry": "the torques fit a {joint} {numbers} m elsewhere on the link before it: check the model's lengths",
    "gravity": "the links have weight, and the model has no gravity: give it {value} m/s2 along {numbers}",
    "unlogged_gravity": "the torques are logged without gravity: log all of each torque, or give the model no gravity",
    "base": "the base stands {value} rad otherwise: declare it as robot.base, with gravity along {numbers}",
    "coupled": "the motor of {joint} turns with {other}: declare coupling = {{ {other} = {value} }} for {joint}",
}
"""What each mistake is, and its remedy."""


class _Case(NamedTuple):
    """A model and log: motion, (3, samples, n), and torques, and 1 where a motor moves, each (samples, n)."""

    robot: Robot
    motion: FloatArray
    torque: FloatArray
    moving: FloatArray

    def logged(self, positions: FloatArray, torques: FloatArray) -> _Case:
        """Case with other logs, linear combinations by matrices, (n, n)."""
        moving = np.abs(np.sign(self.moving @ positions))
        return _Case(self.robot, self.motion @ positions, self.torque @ torques, moving)


class _Change(NamedTuple):
    """A mistake: its code, affected joints, correction, and starts of its numbers."""

    name: str
    joints: Sequence[int]
    correct: Callable[[FloatArray], _Case]
    starts: Sequence[Sequence[float]] = ((),)


def find_robot_cause(robot: Robot, records: Sequence[Record], filtering: Filtering) -> Cause | None:
    """Cause that explains most of rigid IDIM's residual, or None."""
    from scipy.optimize import least_squares

    if len(robot) == 1:  # which has none of these causes
        return None
    declared = _thin(robot, records, filtering)
    error, sizes = _solver(declared)

    def fit(change: _Change, x: FloatArray) -> tuple[float, FloatArray, _Change]:
        return float(np.sum(error(x, change) ** 2)), x, change

    def cost(one: tuple[float, FloatArray, _Change]) -> float:
        """Squares beyond the noise, penalised for each number but those of a base, which a zero imitates."""
        squares, x, change = one
        far = change.name == "geometry" and np.max(np.abs(x)) >= _LONGEST
        beyond = max(squares - float(np.sum(noise)), 0.25 * _BEYOND * len(robot))
        return math.inf if far else beyond * _SIMPLER ** (0 if change.name == "base" else x.size)

    each = ([fit(change, np.array(x)) for x in change.starts] for change in _changes(declared))
    ends = sorted((min(one, key=lambda end: end[0]) for one in each), key=lambda end: end[0])
    free = [one for one in ends if one[1].size]
    near = [one for place, one in enumerate(free) if place < _BEST or one[1].size > 1]
    found = [one for one in ends if not one[1].size]
    found += [fit(change, least_squares(error, x, args=(change,), max_nfev=_STEPS).x) for _, x, change in near]
    _, x, change = min(found, key=lambda end: end[0])
    # Of white noise, differences of successive errors have twice the squares; a model's error changes slowly.
    noise = 0.5 * np.sum(np.diff(error(x, change).reshape(len(robot), -1)) ** 2, axis=1)
    squares, x, change = min(found, key=cost)
    left = np.sum(error(x, change).reshape(len(robot), -1) ** 2, axis=1)
    wrong, still = (np.sum(sizes**2 * np.maximum(one - noise, 0.0)) for one in (1.0, left))
    if still > _LEAVES * wrong or np.min(noise) > 1.0 - _BEYOND:
        return None
    value, joints = _value(change.name, robot, x), tuple(robot.names[k] for k in change.joints)
    said = joints or robot.names
    words = _SAID[change.name].format(
        joint=said[0], other=said[-1], all=join(said), value="" if value is None else number(value, 3),
        numbers=", ".join(f"{one:.2f}" for one in x),
    )  # fmt: skip
    return Cause(change.name, words, value, squares, joints)


def find_copied_reference(robot: Robot, records: Sequence[Record]) -> Cause | None:
    """Joints whose logged position is their reference to rounding, or None."""
    names = []
    for name, record in zip(robot.names, records, strict=True):
        asked, motor = record.reference, record.motor_position
        if asked is not None and motor is not None and asked.values.shape == motor.values.shape:
            apart, travel = np.max(np.abs(asked.values - motor.values)), np.ptp(asked.values)
            names += [name] if apart <= _SAME * travel and travel > 0.0 else []
    if not names:
        return None
    words = f"the motor position of {join(names)} is its reference: log what the encoder measures"
    return Cause("reference_is_position", words, joints=tuple(names))


def _thin(robot: Robot, records: Sequence[Record], filtering: Filtering) -> _Case:
    """Declared case at a few hundred instants, with torques filtered like positions."""
    motion = measure_motion(robot, records, filtering)
    assert motion.filtering.position_cutoff is not None
    torque = lowpass(motion.torque, motion.filtering.position_cutoff, motion.sample_time)
    rows = np.arange(len(torque))[motion.filtering.inside(len(torque))]
    rows = rows[:: max(rows.size // _INSTANTS, 1)]
    moved = np.stack([one[rows] @ robot.coupling.T for one in (motion.q, motion.v, motion.a)])
    moving = motion.moving[rows] * (np.abs(moved[1]) > _REST * np.max(np.abs(moved[1]), axis=0))
    return _Case(robot, moved, torque[rows], moving)


def _solver(declared: _Case) -> tuple[Callable[[FloatArray, _Change], FloatArray], FloatArray]:
    """Residual function of a change, scaled per joint, and the scales, (n,)."""
    # Of any gravity and coupling: some of these columns are sums of others then.
    n, any_way = len(declared.robot), np.array([3.0, 5.0, -7.0])
    parameters = robot_parameters(replace(declared.robot.rigid, gravity=any_way), whole=False)
    sizes, unchanged = np.ones(n), _Change("", (), lambda _: declared)

    def error(x: FloatArray, change: _Change) -> FloatArray:
        case = change.correct(x)
        motion = case.motion @ np.linalg.inv(case.robot.coupling).T
        columns = [parameters.columns(case.robot, *motion), inverse_columns(case.robot, *motion)[:, :, -n:]]
        W = np.concatenate(columns, axis=2) * case.moving[:, :, np.newaxis]
        Y = case.torque * case.moving
        by = sizes * np.maximum(np.linalg.norm(Y, axis=0), np.finfo(float).tiny)
        W = (W / by[:, np.newaxis]).transpose(1, 0, 2).reshape(Y.size, -1)
        y = (Y / by).T.ravel()
        W = W / np.maximum(np.linalg.norm(W, axis=0), np.finfo(float).tiny)
        return np.asarray(y - W @ (np.linalg.pinv(W.T @ W, rcond=_RANK, hermitian=True) @ (W.T @ y)))

    for _ in range(3):
        sizes *= np.maximum(np.linalg.norm(error(np.zeros(0), unchanged).reshape(n, -1), axis=1), 1e-6)
    return error, sizes


# The rows


def _changes(case: _Case) -> Iterator[_Change]:
    """Yield all changes: of the log, of each joint, of the model."""
    robot, n = case.robot, len(case.robot)
    own, same, follows = [*range(n)], np.eye(n), np.linalg.inv(robot.coupling)

    def log(code: str, joints: Sequence[int], positions: FloatArray, torques: FloatArray) -> _Change:
        return _Change(code, joints, lambda _: case.logged(positions, torques))

    for i, j in itertools.combinations(own, 2):
        other = same[:, [j if k == i else i if k == j else k for k in own]]
        yield log("swapped_channels", (i, j), same, other)
        yield log("order", (i, j), other, other)
        yield log("swapped_positions", (i, j), other, same)
    first = sorted(own, key=robot.names.__getitem__)
    orders = {tuple(own[::-1]), tuple(map(first.index, own)), *((*own[by:], *own[:by]) for by in own[1:])}
    for order in sorted(orders):
        yield log("order", order, same[:, list(order)], same[:, list(order)])
    for k, link in enumerate(robot.links):
        for code, position, torque in _OF_JOINT:
            starts = ((),) if code.endswith("sign") else _FACTORS
            yield _Change(code, (k,), partial(_scale, case, k, position, torque), starts)
        if link.kind == "revolute":
            turn = partial(lambda axis, x: case._replace(robot=robot.turn(x[0] * axis)), same[k])
            yield _Change("zero", (k,), turn, _ZEROS)
        if k:  # the place of the first one moves the base
            yield _Change("geometry", (k,), partial(_lengthen, case, k), ((0.0, 0.0, 0.0),))
    weighs, size = "base" if np.any(robot.gravity) else "gravity", float(np.linalg.norm(robot.gravity)) or _GRAVITY
    yield _Change(
        weighs, (), lambda x: case._replace(robot=replace(robot, gravity=size * x / np.linalg.norm(x))),
        [*np.eye(3), *-np.eye(3)],
    )  # fmt: skip
    yield _Change("unlogged_gravity", (), lambda _: case._replace(robot=replace(robot, gravity=np.zeros(3))))
    for i, j in itertools.permutations(own, 2):
        # Where joint j moves with motor i, some factor would leave a joint that no motor moves.
        if abs(i - j) == 1 and not robot.joints[i].coupling and abs(follows[j, i]) < _RANK:
            yield _Change("coupled", (i, j), partial(_couple, case, i, j), _COUPLED)


def _scale(case: _Case, k: int, position: int, torque: int, x: FloatArray) -> _Case:
    factor, by = math.exp(x[0]) if x.size else -1.0, np.ones((2, len(case.robot)))
    by[:, k] = factor**position, factor**torque
    return case.logged(*map(np.diag, by))


def _lengthen(case: _Case, k: int, x: FloatArray) -> _Case:
    links = list(case.robot.links)
    links[k] = replace(links[k], origin=links[k].origin + x)
    return case._replace(robot=replace(case.robot, links=tuple(links)))


def _couple(case: _Case, motor: int, joint: int, x: FloatArray) -> _Case:
    joints = list(case.robot.joints)
    joints[motor] = replace(joints[motor], coupling={case.robot.names[joint]: float(x[0])})
    return case._replace(robot=replace(case.robot, joints=tuple(joints)))


def _value(code: str, robot: Robot, x: FloatArray) -> float | None:
    """Meaning of a change's numbers: a factor, an angle or gravity."""
    if code == "base":
        cosine = float(robot.gravity @ x) / float(np.linalg.norm(robot.gravity) * np.linalg.norm(x))
        return math.acos(min(max(cosine, -1.0), 1.0))
    if code in ("gravity", "geometry") or not x.size:
        return _GRAVITY if code == "gravity" else None
    if code == "zero":
        return math.remainder(float(x[0]), 2 * math.pi)
    return float(x[0]) if code == "coupled" else math.exp(-x[0])
