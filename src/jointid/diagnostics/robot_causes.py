"""Causes of a misfit that concern more than the torque of one joint: a base, a gear, an order, a coupling, a length.

Each is a change of the log or of the model, with which the inverse model is solved again on some hundred instants. Its
numbers are searched on a grid, then by descent (variable projection). The rows of each joint are divided by the size of
its error as declared, so the sum of squares is the number of joints before a cause is corrected. The cause that lowers
it most is named. To add one, yield its row in `_changes`.
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
from jointid.estimation.problems.inverse_model import motion_of_robot
from jointid.estimation.robots.numbers import robot_parameters
from jointid.models.robots.base_parameters import inverse_columns
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, lowpass

_INSTANTS = 200
_RANK = 1e-12  # of the normal matrix, whose columns have length 1
_LEAST = 0.5  # of the squares of one joint's residual: what a cause explains at least
_SIMPLER = 1.25  # times: so much more may be left by a cause with one free number less
_BEST = 4  # causes whose numbers are searched, beside those that begin at what is declared:
_FROM_DECLARED = ("base", "geometry")
_STEPS = 8  # of a descent
_TWO = 2  # joints: one alone has none of these causes
_SAME = 1e-9  # of the travel
_REST = 0.02  # of the largest speed: below, Coulomb friction is left out
_ZEROS = tuple((np.pi / 6 * k,) for k in range(-5, 7) if k)  # rad
_GEARS = tuple((math.log(one),) for one in (0.1, 0.3, 0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 3.0, 10.0))
_UNITS = tuple((sign * math.log(one),) for one in (180 / math.pi, 1e3) for sign in (1.0, -1.0))
_COUPLED = ((-1.0,), (-0.5,), (0.5,), (1.0,))
_GRAVITY = 9.81  # m/s2
_LONGEST = 1.0  # m: a longer correction of a length is none

_OF_PAIRS = (
    ("swapped_channels", False, True, "the torques of {joint} and {other} are exchanged: exchange the columns"),
    ("order", True, True, "the logs of {joint} and {other} are exchanged: give each joint the columns of the other"),
    ("swapped_positions", True, False, "the positions of {joint} and {other} are exchanged: exchange the columns"),
)
"""Of two joints: the code, whether positions and torques are exchanged, and the words."""

_OF_JOINTS: tuple[tuple[str, int, int, Sequence[Sequence[float]], str], ...] = (
    (
        "torque_sign", 0, 1, ((),),
        "the torque of {joint} has the wrong sign: turn torque.sign round in joints.channels, or in record.channels",
    ),
    ("log_gain", 0, 1, _GEARS, "the logged torque of {joint} is {value} times what moves it: check its unit"),
    (
        "position_sign", 1, 0, ((),),
        "the position of {joint} has the wrong sign: turn motor_position.sign round in its joints.channels",
    ),
    (
        "joint_sign", 1, 1, ((),),
        "position and torque of {joint} count the other way than the model's axis: turn motor_position.sign and "
        "torque.sign round in its joints.channels",
    ),
    (
        "gear_ratio", 1, -1, _GEARS,
        "the gear of {joint} has {value} times the declared ratio: position and torque are off by it",
    ),
    (
        "position_scale", 1, 0, (*_GEARS, *_UNITS),
        "the position of {joint} is {value} times what moves the links: check its unit and its ratio",
    ),
)  # fmt: skip
"""Of one joint: the code, powers of a factor on position and torque, its starts (-1 if it has none), and the words."""


class _Case(NamedTuple):
    """A model and a log: positions, velocities and accelerations of the motors, (3, samples, n), and their torques.

    The torques, and 1 where a motor moves, are (samples, n).
    """

    robot: Robot
    motion: FloatArray
    torque: FloatArray
    moving: FloatArray


class _Change(NamedTuple):
    """A mistake with its numbers.

    Attributes:
        name: its code.
        joints: that it concerns.
        words: with the first and last of these as {joint} and {other}, its {value}, and its numbers as {numbers}.
        correct: returns the case in which it is corrected.
        value: that its numbers are.
        starts: of a search for them.
    """

    name: str
    joints: Sequence[int]
    words: str
    correct: Callable[[FloatArray], _Case]
    value: Callable[[FloatArray], float | None] = lambda _: None
    starts: Sequence[Sequence[float]] = ((),)

    def cost(self, left: float, x: FloatArray) -> float:
        """Return the squares that are left, of more numbers as if they were more.

        A base counts as none: a zero off by half a turn predicts what one upside down does.
        """
        if self.name == "geometry" and np.max(np.abs(x)) >= _LONGEST:
            return math.inf
        return left * _SIMPLER ** (0 if self.name == "base" else x.size)

    def explain(self, names: Sequence[str], x: FloatArray, left: float) -> Cause:
        """Return the cause, of joints of these names."""
        value, joints = self.value(x), tuple(names[k] for k in self.joints)
        said = joints or names
        words = self.words.format(
            joint=said[0], other=said[-1], all=join(said), names=join(names),
            value="" if value is None else number(value, 3), numbers=", ".join(f"{one:.2f}" for one in x),
        )  # fmt: skip
        return Cause(self.name, words, value, left, joints)


def find_robot_cause(robot: Robot, records: Sequence[Record], filtering: Filtering) -> Cause | None:
    """Return the cause that explains most of the residual of IDIM of rigid joints; None where none explains enough."""
    if len(robot) < _TWO:
        return None
    declared = _thin(robot, records, filtering)
    solve = _Solver(declared)

    def left(change: _Change, x: Sequence[float]) -> tuple[float, FloatArray, _Change]:
        return float(np.sum(solve.error(change.correct(np.array(x))) ** 2)), np.array(x), change

    ends = [min((left(change, x) for x in change.starts), key=lambda one: one[0]) for change in _changes(declared)]
    ends.sort(key=lambda one: one[0])
    found, free = [one for one in ends if not one[1].size], [one for one in ends if one[1].size]
    for _, start, change in (*free[:_BEST], *(one for one in free[_BEST:] if one[2].name in _FROM_DECLARED)):
        found.append((*solve.descend(change.correct, start), change))
    least, x, change = min(found, key=lambda one: one[2].cost(one[0], one[1]))
    return change.explain(robot.names, x, least) if len(robot) - least >= _LEAST else None


def find_copied_reference(robot: Robot, records: Sequence[Record]) -> Cause | None:
    """Return the joints whose logged position is their reference to rounding; None without any."""
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
    """Return the declared case at some hundred instants, the torques through the filter of the positions."""
    motion = motion_of_robot(robot, records, filtering)
    assert motion.filtering.position_cutoff is not None
    torque = lowpass(motion.torque, motion.filtering.position_cutoff, motion.sample_time)
    rows = np.arange(len(torque))[motion.inside]
    rows = rows[:: max(rows.size // _INSTANTS, 1)]
    moved = np.stack([one[rows] @ robot.coupling.T for one in (motion.q, motion.v, motion.a)])
    moving = motion.moving[rows] * (np.abs(moved[1]) > _REST * np.max(np.abs(moved[1]), axis=0))
    return _Case(robot, moved, torque[rows], moving)


class _Solver:
    """Least squares of all cases, each joint's rows by the size of its error as declared."""

    def __init__(self, declared: _Case) -> None:
        # Of any gravity and coupling: some of these columns are sums of others then.
        robot = declared.robot
        self.parameters = robot_parameters(replace(robot.rigid, gravity=np.array([3.0, 5.0, -7.0])), whole=False)
        self.sizes = np.ones(len(robot))
        for _ in range(3):
            error = self.error(declared).reshape(len(robot), -1)
            self.sizes *= np.maximum(np.linalg.norm(error, axis=1), 1e-6)

    def error(self, case: _Case) -> FloatArray:
        """Return the residual, joint after joint, in units of that of the declared case."""
        q, v, a = case.motion @ np.linalg.inv(case.robot.coupling).T
        rotors = inverse_columns(case.robot, q, v, a)[:, :, -len(case.robot) :]
        columns = [self.parameters.columns(case.robot, q, v, a), rotors]
        W = np.concatenate(columns, axis=2) * case.moving[:, :, np.newaxis]
        Y = case.torque * case.moving
        by = self.sizes * np.maximum(np.linalg.norm(Y, axis=0), np.finfo(float).tiny)
        W = (W / by[:, np.newaxis]).transpose(1, 0, 2).reshape(Y.size, -1)
        y = (Y / by).T.ravel()
        W = W / np.maximum(np.linalg.norm(W, axis=0), np.finfo(float).tiny)
        return np.asarray(y - W @ (np.linalg.pinv(W.T @ W, rcond=_RANK, hermitian=True) @ (W.T @ y)))

    def descend(self, correct: Callable[[FloatArray], _Case], x: FloatArray) -> tuple[float, FloatArray]:
        """Return the least squares from a start, by a few steps, and its numbers."""
        from scipy.optimize import least_squares

        def error(x: FloatArray) -> FloatArray:
            return self.error(correct(x))

        found = least_squares(error, x, max_nfev=_STEPS)
        return 2.0 * float(found.cost), found.x


# The rows


def _changes(case: _Case) -> Iterator[_Change]:
    """Yield all changes: of the log, of one joint after the other, and of the model."""
    robot = case.robot
    names, own = robot.names, [*range(len(robot))]
    for i, j in itertools.combinations(own, 2):
        other = [j if k == i else i if k == j else k for k in own]
        for code, positions, torques, words in _OF_PAIRS:
            yield _Change(
                code, (i, j), words,
                partial(_arrange, case, other if positions else own, other if torques else own),
            )  # fmt: skip
    first = sorted(own, key=names.__getitem__)
    orders = {tuple(own[::-1]), tuple(map(first.index, own)), *((*own[by:], *own[:by]) for by in own[1:])}
    for order in sorted(one for one in orders if sum(k != at for k, at in enumerate(one)) > _TWO):
        words = "the log has the joints in another order: the columns of {all} are of {names}"
        yield _Change("order", order, words, partial(_arrange, case, [*order], [*order]))
    for k, link in enumerate(robot.links):
        for code, position, torque, starts, words in _OF_JOINTS:
            yield _Change(code, (k,), words, partial(_scale, case, k, position, torque), _factor, starts)
        if link.kind == "revolute":
            words = "the encoder of {joint} reads 0 where the joint of the model is near {value} rad: check it, and "
            yield _Change("zero", (k,), words + "give its zero in its table", partial(_turn, case, k), _angle, _ZEROS)
        if k:  # the place of the first one moves the base
            words = "the geometry of the model is not that of the robot: the torques fit a {joint} that stands "
            words += "{numbers} m elsewhere on the link before it: check the model's lengths"
            yield _Change("geometry", (k,), words, partial(_lengthen, case, k), _length, ((0.0, 0.0, 0.0),))
    known = float(np.linalg.norm(robot.gravity))
    code, words = "gravity", "the links weigh something, and the model has no gravity: give it {value} m/s2 along "
    if known:
        code, words = "base", "the base stands {value} rad otherwise in the model's frame: declare it as robot.base "
        words += "(roll, pitch, yaw), with gravity along "
    tilt = partial(_tilt, robot.gravity) if known else lambda _: _GRAVITY
    yield _Change(
        code, (), words + "{numbers}", partial(_hang, case, known or _GRAVITY), tilt, [*np.eye(3), *-np.eye(3)]
    )
    follows = np.linalg.inv(robot.coupling)
    for i, j in itertools.permutations(own, 2):
        # Where joint j moves with motor i, some factor would leave a joint that no motor moves.
        if abs(i - j) == 1 and not robot.joints[i].coupling and abs(follows[j, i]) < _RANK:
            words = "the motor of {joint} turns with {other}: declare coupling = {{ {other} = {value} }} for {joint}"
            yield _Change("coupled", (i, j), words, partial(_couple, case, i, j), lambda x: float(x[0]), _COUPLED)


def _arrange(case: _Case, positions: Sequence[int], torques: Sequence[int], _: FloatArray) -> _Case:
    at = list(positions)
    return _Case(case.robot, case.motion[:, :, at], case.torque[:, list(torques)], case.moving[:, at])


def _scale(case: _Case, k: int, position: int, torque: int, x: FloatArray) -> _Case:
    factor, by = math.exp(x[0]) if x.size else -1.0, np.ones((2, len(case.robot)))
    by[:, k] = factor**position, factor**torque
    return case._replace(motion=case.motion * by[0], torque=case.torque * by[1])


def _turn(case: _Case, k: int, x: FloatArray) -> _Case:
    return case._replace(robot=case.robot.turn(x[0] * np.eye(len(case.robot))[k]))


def _lengthen(case: _Case, k: int, x: FloatArray) -> _Case:
    links = list(case.robot.links)
    links[k] = replace(links[k], origin=links[k].origin + x)
    return case._replace(robot=replace(case.robot, links=tuple(links)))


def _hang(case: _Case, size: float, x: FloatArray) -> _Case:
    return case._replace(robot=replace(case.robot, gravity=size * x / np.linalg.norm(x)))


def _couple(case: _Case, motor: int, joint: int, x: FloatArray) -> _Case:
    joints = list(case.robot.joints)
    joints[motor] = replace(joints[motor], coupling={case.robot.names[joint]: float(x[0])})
    return case._replace(robot=replace(case.robot, joints=tuple(joints)))


def _factor(x: FloatArray) -> float | None:
    return math.exp(-x[0]) if x.size else None


def _angle(x: FloatArray) -> float:
    return float((x[0] + math.pi) % (2 * math.pi) - math.pi)


def _length(x: FloatArray) -> float:
    return float(np.linalg.norm(x))


def _tilt(gravity: FloatArray, x: FloatArray) -> float:
    cosine = float(gravity @ x) / float(np.linalg.norm(gravity) * np.linalg.norm(x))
    return math.acos(min(max(cosine, -1.0), 1.0))
